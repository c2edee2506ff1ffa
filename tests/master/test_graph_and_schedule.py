"""The graph rejects inconsistent connections; the schedule is exact; dependencies set the order."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas
import pytest
from hypothesis import given
from hypothesis import strategies as st

from freeflyer.fmi.component import Port, PythonComponent
from freeflyer.foundation import clock
from freeflyer.foundation.errors import CosimError, GraphError, ScenarioError
from freeflyer.foundation.units import converted, factor, same
from freeflyer.master import graph, schedule
from freeflyer.master.connection import Connection
from freeflyer.master.divergence import Limit
from freeflyer.master.master import Master

MS = 1_000_000


def port(
    name: str, causality: str, size: int = 1, unit: str | None = "m", direct: tuple[str, ...] = ()
) -> Port:
    return Port(
        name=name,
        size=size,
        causality=causality,
        units=(unit,) * size,
        start=(0.0,) * size,
        direct=frozenset(direct),
    )


class Plant(PythonComponent):
    """x' = u, integrated exactly; the output is the state, without direct dependency."""

    def __init__(self, name: str) -> None:
        super().__init__(name, [port("u", "input", unit="m/s"), port("x", "output")])

    def advance(self, time: float, size: float) -> None:
        self.values["x"] += size * self.values["u"]


class Gain(PythonComponent):
    """y = k u of the same instant; records the times of its steps."""

    def __init__(self, name: str, k: float, unit: str = "m/s") -> None:
        super().__init__(name, [port("u", "input"), port("y", "output", unit=unit, direct=("u",))])
        self.k, self.log = k, []

    def advance(self, time: float, size: float) -> None:
        self.log.append((time, size, float(self.values["u"][0])))
        self.values["y"][:] = self.k * self.values["u"]


def ready(
    components: dict[str, PythonComponent],
    connections: list[Connection],
    steps: dict[str, int],
    stop: int,
    **more: object,
) -> Master:
    plan = schedule.build(steps, stop, min(steps.values()), dict.fromkeys(components, True))
    master = Master(graph.build(components, connections), plan, **more)  # type: ignore[arg-type]
    master.initialise({})
    return master


def loop(k: float = -1.0) -> tuple[dict[str, PythonComponent], list[Connection]]:
    components = {"plant": Plant("plant"), "gain": Gain("gain", k)}
    return components, [
        Connection(source="plant.x", target="gain.u"),
        Connection(source="gain.y", target="plant.u"),
    ]


def test_a_controller_uses_the_plant_output_of_the_same_instant() -> None:
    components, connections = loop()
    components["plant"].values["x"][:] = 1.0
    outcome = ready(components, connections, {"plant": 10 * MS, "gain": 10 * MS}, 100 * MS).run()
    x, y = outcome.record["plant.x"], outcome.record["gain.y"]
    assert np.array_equal(y[:-1], -x[:-1])
    assert x[1] == pytest.approx(0.99)
    assert x[10] == pytest.approx(0.99**10)


def test_a_slow_controller_samples_and_holds() -> None:
    components, connections = loop()
    components["plant"].values["x"][:] = 1.0
    outcome = ready(components, connections, {"plant": 10 * MS, "gain": 30 * MS}, 100 * MS).run()
    assert outcome.steps == {"plant": 10, "gain": 4}
    x, y = outcome.record["plant.x"], outcome.record["gain.y"]
    assert np.array_equal(y, -x[[0, 0, 0, 3, 3, 3, 6, 6, 6, 9, 9]])
    # The last step is shortened and ends at the stop time.
    assert [round(size, 9) for _, size, _ in components["gain"].log] == [0.03, 0.03, 0.03, 0.01]


def test_a_slow_plants_output_is_not_used_before_the_end_of_its_step() -> None:
    plant, gain = Plant("plant"), Gain("gain", 2.0)
    plant.values["u"][:] = 1.0
    master = ready(
        {"plant": plant, "gain": gain},
        [Connection(source="plant.x", target="gain.u")],
        {"plant": 30 * MS, "gain": 10 * MS},
        90 * MS,
    )
    y = master.run().record["gain.y"]
    assert y[:9] == pytest.approx([0, 0, 0, 0.06, 0.06, 0.06, 0.12, 0.12, 0.12])


def test_a_delayed_connection_delivers_the_previous_value_and_breaks_a_loop() -> None:
    a, b = Gain("a", 1.0, "m"), Gain("b", 1.0, "m")
    forward, back = (
        Connection(source="a.y", target="b.u"),
        Connection(source="b.y", target="a.u", delayed=True),
    )
    built = graph.build({"b": b, "a": a}, [forward, back])
    assert built.first == ("a", "b")
    a.values["u"][:] = 0.0
    with pytest.raises(
        GraphError, match=r"algebraic loop: .*a.*b.*declare one of the connections delayed"
    ):
        graph.build({"a": a, "b": b}, [forward, Connection(source="b.y", target="a.u")])


def test_a_loop_through_a_state_is_not_an_algebraic_loop() -> None:
    components, connections = loop()
    built = graph.build(components, connections)
    assert built.first == ("gain",)
    assert built.then == ("plant",)


@pytest.mark.parametrize(
    ("connection", "message"),
    [
        (("plant.x", "gian.u"), "no component 'gian'; did you mean 'gain'"),
        (("plant.xx", "gain.u"), "component 'plant' has no variable 'xx'; did you mean 'x'"),
        (("plant.u", "gain.u"), "plant.u is of causality input; an output is expected"),
        (("plant.x", "gain.y"), "gain.y is of causality output; an input is expected"),
        (("plant.x", "plant.u"), "units differ: m and m/s"),
        (("wide.x", "gain.u"), "sizes differ: 3 and 1"),
    ],
)
def test_an_invalid_connection_is_rejected(connection: tuple[str, str], message: str) -> None:
    components, _ = loop()
    components["wide"] = PythonComponent("wide", [port("x", "output", 3)])
    with pytest.raises(GraphError, match=message):
        graph.build(components, [Connection(source=connection[0], target=connection[1])])


def test_an_input_with_two_sources_is_rejected() -> None:
    components, connections = loop()
    components["other"] = Plant("other")
    with pytest.raises(GraphError, match=r"input gain.u has two sources: plant.x and other.x"):
        graph.build(components, [*connections, Connection(source="other.x", target="gain.u")])


def test_equivalent_units_may_be_connected() -> None:
    assert same("N.m", "J")
    assert same("rad/s", None)
    assert not same("deg", "rad")
    assert factor("deg", "rad") == pytest.approx(np.pi / 180)
    assert factor("kg.m2", "g.cm2") == pytest.approx(1e7)
    with pytest.raises(ValueError, match="unit 'furlongs_' is not known"):
        factor("furlongs_", "m")


def test_a_step_that_is_not_a_multiple_is_rejected_with_steps_that_would_fit() -> None:
    with pytest.raises(
        GraphError,
        match=r"component b: its step of 0.0025 s is not a multiple of the smallest step, 0.001 s; 0.002 s or 0.003 s would fit",
    ):
        schedule.build({"a": MS, "b": 2_500_000}, 100 * MS, MS, {"a": True, "b": True})
    with pytest.raises(GraphError, match=r"the stop time of 0.0105 s is not a multiple"):
        schedule.build({"a": MS}, 10_500_000, MS, {"a": True})
    with pytest.raises(
        GraphError, match=r"component b cannot shorten its last step.*0.009 s would fit"
    ):
        schedule.build({"a": MS, "b": 3 * MS}, 10 * MS, MS, {"a": True, "b": False})


@given(st.integers(1, 9_000_000_000))
def test_decimal_seconds_are_exact_nanoseconds(microseconds: int) -> None:
    assert clock.nanoseconds(microseconds / 1_000_000, "x") == microseconds * 1000


@given(st.integers(1, 10**6), st.sampled_from((("ms", 10**6), ("us", 10**3), ("s", 10**9))))
def test_times_in_other_units_are_exact_nanoseconds(number: int, unit: tuple[str, int]) -> None:
    name, in_nanoseconds = unit
    assert clock.nanoseconds(converted(number, factor(name, "s")), "x") == number * in_nanoseconds


@pytest.mark.parametrize(
    ("value", "expected"),
    [
        (0.0, "a time greater than zero"),
        (-1.0, "a time greater than zero"),
        (float("nan"), "a time greater than zero"),
        (1e-10, "a whole number of nanoseconds"),
        (1 / 3, "a whole number of nanoseconds"),
        (float("inf"), "at most 9000000000 s"),
        (1e12, "at most 9000000000 s"),
        (10**400, "at most 9000000000 s"),
    ],
)
def test_times_that_are_no_nanoseconds_are_rejected(value: float, expected: str) -> None:
    with pytest.raises(ScenarioError, match=f"^x is .* s; {expected} is expected$"):
        clock.nanoseconds(value, "x")


def test_a_limit_ends_the_run_with_its_cause_and_keeps_the_record() -> None:
    plant = Plant("plant")
    plant.values["u"][:] = 1.0
    limit = Limit(signal="plant.x", bound=0.0345, cause="too far")
    outcome = ready({"plant": plant}, [], {"plant": 10 * MS}, 100 * MS, limits=[limit]).run()
    assert outcome.diverged
    assert outcome.cause == "too far: plant.x is 0.04, the limit is 0.0345"
    assert outcome.simulated == 0.04
    assert outcome.record.time[-1] == 0.04
    with pytest.raises(CosimError, match="did you mean"):
        ready(
            {"plant": plant},
            [],
            {"plant": 10 * MS},
            100 * MS,
            limits=[Limit(signal="plamt.x", bound=1.0, cause="")],
        )


def test_nan_exceeds_every_limit() -> None:
    class Careless(Plant):
        def step(self, time: float, size: float) -> None:
            self.advance(time, size)

    plant = Careless("plant")
    plant.values["u"][:] = np.nan
    limit = Limit(signal="plant.x", bound=1.0, cause="x")
    outcome = ready({"plant": plant}, [], {"plant": 10 * MS}, 100 * MS, limits=[limit]).run()
    assert outcome.diverged
    assert outcome.simulated == 0.01


def test_a_failing_component_ends_the_run_with_its_name() -> None:
    class Failing(Plant):
        def advance(self, time: float, size: float) -> None:
            super().advance(time, size)
            if time > 0.05:
                raise RuntimeError("out of fuel")

    outcome = ready({"plant": Failing("plant")}, [], {"plant": 10 * MS}, 100 * MS).run()
    assert outcome.failed
    assert not outcome.diverged
    assert outcome.cause is not None
    assert outcome.cause.startswith("plant: RuntimeError: out of fuel (")
    assert f"{Path(__file__).name}, line " in outcome.cause
    assert outcome.record.rows == 7


def test_a_minimum_is_also_a_limit() -> None:
    plant = Plant("plant")
    plant.values["u"][:] = -1.0
    limit = Limit(signal="plant.x", bound=-0.025, is_minimum=True, cause="too low")
    outcome = ready({"plant": plant}, [], {"plant": 10 * MS}, 100 * MS, limits=[limit]).run()
    assert outcome.cause == "too low: plant.x is -0.03, the smallest allowed value is -0.025"


def test_a_limit_on_missing_elements_is_rejected() -> None:
    with pytest.raises(GraphError, match="elements 1 to 2 are watched, but the signal has 1"):
        ready(
            {"plant": Plant("plant")},
            [],
            {"plant": 10 * MS},
            100 * MS,
            limits=[Limit(signal="plant.x", bound=1.0, cause="", elements=(1, 2))],
        )


def test_a_component_with_direct_and_other_connected_outputs_must_be_declared() -> None:
    class Both(Plant):
        """x' = u. The second output `a` is declared as directly dependent on u."""

        def __init__(self, name: str) -> None:
            PythonComponent.__init__(
                self,
                name,
                [port("u", "input"), port("x", "output"), port("a", "output", direct=("u",))],
            )

    components = {
        "plant": Both("plant"),
        "one": Gain("one", 1.0, "m"),
        "two": Gain("two", 1.0, "m"),
    }
    wires = [
        Connection(source="plant.x", target="one.u"),
        Connection(source="plant.a", target="two.u"),
    ]
    with pytest.raises(
        GraphError, match="its output a depends directly on its inputs and its output x does not"
    ):
        graph.build(components, wires)
    assert "plant" in graph.build(components, wires, {"plant": False}).then
    assert graph.build(components, wires, {"plant": True}).first[0] == "plant"


def test_an_input_has_its_own_start_value_until_its_source_is_initialised() -> None:
    class Careful(Plant):
        def __init__(self, name: str) -> None:
            ports = [
                port("x", "output"),
                Port(name="u", size=1, causality="input", units=("m/s",), start=(0.7,)),
            ]
            PythonComponent.__init__(self, name, ports)

        def initialise(self, start: float) -> None:
            self.seen = float(self.values["u"][0])

    plant, gain = Careful("plant"), Gain("gain", -1.0)
    ready(
        {"plant": plant, "gain": gain},
        [
            Connection(source="plant.x", target="gain.u"),
            Connection(source="gain.y", target="plant.u"),
        ],
        {"plant": 10 * MS, "gain": 10 * MS},
        100 * MS,
    )
    assert plant.seen == 0.7


@pytest.mark.parametrize(
    ("ports", "message"),
    [
        ({"size": 3, "units": ("m",), "start": None}, "size is 3, but it has 1 units"),
        ({"size": 3, "units": ("m",) * 3, "start": (1.0, 2.0)}, "2 start values"),
        ({"size": 1, "units": ("blorg",), "start": None}, "unit 'blorg' is not known"),
        (
            {"size": 1, "units": ("m",), "start": None, "causality": "outptu"},
            "causality is 'outptu'",
        ),
    ],
)
def test_invalid_ports_of_python_components_are_rejected(ports: dict, message: str) -> None:
    with pytest.raises(CosimError, match=message):
        PythonComponent("mine", [Port(**{"name": "y", "causality": "output", **ports})])


def test_a_python_component_may_assign_its_outputs_but_they_must_be_finite() -> None:
    class Assigning(Plant):
        def advance(self, time: float, size: float) -> None:
            self.values["x"] = np.array([time + size if time < 0.05 else np.nan])

    outcome = ready({"plant": Assigning("plant")}, [], {"plant": 10 * MS}, 100 * MS).run()
    assert outcome.record["plant.x"][3] == pytest.approx(0.03)
    assert outcome.failed
    assert "finite numbers are expected" in str(outcome.cause)


def test_the_record_loads_in_one_line_with_units(tmp_path: Path) -> None:
    components, connections = loop()
    record = (
        ready(components, connections, {"plant": 10 * MS, "gain": 10 * MS}, 100 * MS).run().record
    )
    record.write(tmp_path / "record.parquet")
    frame = pandas.read_parquet(tmp_path / "record.parquet")
    assert list(frame) == ["time", "plant.x", "gain.y"]
    assert frame.attrs["units"] == {"time": "s", "plant.x": "m", "gain.y": "m/s"}
    assert np.array_equal(frame["plant.x"], record["plant.x"])
    assert list(tmp_path.iterdir()) == [tmp_path / "record.parquet"]
