"""Compare two periods of the base controller in one figure."""

import freeflyer as ff

loop = ff.load("multirate_passive", {"stop_s": 40.0})
slow = ff.run(loop, {"base_controller.period": "0.5 s"})
fast = ff.run(loop, {"base_controller.period": "0.1 s"})
print(slow, fast, sep="\n\n")
slow.plot(fast, labels=["T_b = 0.5 s", "T_b = 0.1 s"]).savefig("two_periods.png", dpi=150)
