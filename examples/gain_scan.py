"""Scan the stiffness of the base over its period, on all cores, and save the stability map.

This example needs the extra `sweep`.
"""

import freeflyer as ff

result = ff.sweep(
    {
        "title": "Stiffness of the base's rotation over T_b",
        "scenario": "multirate_unstable",
        "set": ["stop_s=100"],
        "grid": {
            "base_controller.period": {"first": 0.05, "last": 0.35, "count": 4},
            "base_controller.stiffness[4:6]": [10.0, 20.0, 40.0, 80.0],
        },
        "map": {
            "x": "base_controller.period",
            "y": "base_controller.stiffness[4:6]",
            "predict": True,
        },
    },
    directory="gain_scan",
)
print(result)
print(result.to_pandas().groupby("base_controller.stiffness[4:6]")["stable"].mean())
result.plot().savefig("gain_scan.png", dpi=150)
