"""The fault matrix: every fault, what must come of it and by when. The tests run these rows; docs/fault_matrix.md is made of them.

python tests/faults/fault_matrix.py > docs/fault_matrix.md
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

ARM, BASE = "arm_drive", "base_robot"
TO_CONTROLLER, TO_DEVICE, BOTH = "to_controller", "to_device", "both"
BEGIN = 0.1
"""[s] after activation."""

ARM_WATCHDOG = "the arm went to safe_stop by itself"
ARM_SILENT = "20 cycles in a row were lost"
BASE_SILENT = "2 cycles in a row were lost|3 cycles within 0.2 s were lost"
BASE_WATCHDOG = "the base robot does not take set points any more"


@dataclass(frozen=True, kw_only=True)
class Row:
    """One fault and its stated reaction. `stop`: what the reason must say (a regular expression), or None: the loop goes on.

    `within` [s] from the fault's begin: until the controllers have decided to stop, and until the device itself is safe, where it
    decides by itself. `counted`: counters of which one or more must not be zero.
    """

    device: str
    direction: str = BOTH
    kind: str
    how: dict[str, Any] = field(default_factory=dict)
    reaction: str
    stop: str | None = None
    within: float | None = None
    device_within: float | None = None
    counted: tuple[str, ...] = ()
    lasts: float = 0.4
    """How long the run goes on after the fault's begin, if nothing stops it [s]."""
    seed: int = 1

    @property
    def name(self) -> str:
        how = "-".join(f"{key}={value:g}" for key, value in self.how.items())
        return "-".join(part for part in (self.device, self.kind, self.direction, how) if part)

    @property
    def fault(self) -> dict[str, Any]:
        return {
            "kind": self.kind,
            "device": self.device,
            "direction": self.direction,
            "begin_s": BEGIN,
            **self.how,
        }


@dataclass(frozen=True, kw_only=True)
class ProcessRow:
    """What happens to a whole process or its disk; `test` is where it is tested, FILE::FUNCTION."""

    what: str
    reaction: str
    within: str
    test: str


def _arm_rows() -> Iterator[Row]:
    lost_answers = "late answers: the arm's watchdog after 4 cycles; the controller after 20, or when the arm says so"
    refused = "refused by E2E, as if lost: "
    for share, direction, row in (
        (0.01, TO_CONTROLLER, {"reaction": "held over, counted", "lasts": 2.0}),
        (0.05, TO_CONTROLLER, {"reaction": "held over, counted", "lasts": 2.0}),
        (0.2, TO_CONTROLLER, {"reaction": "4 cycles without an answer come at random, some 0.8 s on average; then the arm's watchdog",
                              "stop": ARM_WATCHDOG, "within": 5.0, "lasts": 6.0}),
        (0.01, TO_DEVICE, {"reaction": "the last command acts on, counted", "lasts": 2.0}),
        (0.05, TO_DEVICE, {"reaction": "the last command acts on, counted", "lasts": 2.0}),
        (0.2, TO_DEVICE, {"reaction": "as to the controller: some 0.8 s on average, then the arm's watchdog",
                          "stop": ARM_WATCHDOG, "within": 5.0, "lasts": 6.0}),
    ):  # fmt: skip
        counted = ("cycles_lost",) if direction == TO_CONTROLLER else ("commands_late_or_lost",)
        yield Row(
            device=ARM,
            direction=direction,
            kind="loss",
            how={"probability": share},
            counted=counted,
            **row,
        )  # type: ignore[arg-type]
    for kind, how in (("cut", {}), ("flipped_bits", {"bits": 1}), ("flipped_bits", {"bits": 8}), ("wrong_data_id", {}), ("frozen_counter", {}),
                      ("stale_stamp", {})):  # fmt: skip
        prefix = (
            ""
            if kind == "cut"
            else refused.replace("by E2E", "for its number")
            if kind == "stale_stamp"
            else refused
        )
        yield Row(device=ARM, direction=TO_CONTROLLER, kind=kind, how=how, stop=ARM_SILENT, within=0.0225, device_within=0.0065,
                  reaction=prefix + lost_answers, counted=("cycles_lost",))  # fmt: skip
        yield Row(device=ARM, direction=TO_DEVICE, kind=kind, how=how, stop=ARM_WATCHDOG, within=0.006, device_within=0.005,
                  reaction=prefix + "the arm's watchdog after 4 cycles, which it says", counted=("commands_late_or_lost",))  # fmt: skip
    yield Row(
        device=ARM,
        direction=BOTH,
        kind="cut",
        how={"duration_s": 0.002},
        reaction="held over, counted",
        counted=("cycles_lost",),
    )
    yield Row(device=ARM, direction=BOTH, kind="cut", how={"duration_s": 0.015}, stop=ARM_WATCHDOG, within=0.018, device_within=0.0055,
              reaction="the arm's watchdog after 4 cycles; the controller learns of it when the link is back")  # fmt: skip
    for direction in (TO_CONTROLLER, TO_DEVICE):
        yield Row(device=ARM, direction=direction, kind="delay", how={"delay_s": 0.002}, reaction="late answers are used and counted",
                  counted=("commands_late_or_lost",))  # fmt: skip
        yield Row(device=ARM, direction=direction, kind="delay", how={"delay_s": 0.01}, stop=f"{ARM_WATCHDOG}|{ARM_SILENT}", within=0.016,
                  device_within=0.0065, reaction="answers that are 4 cycles late are none: the arm's watchdog")  # fmt: skip
        yield Row(device=ARM, direction=direction, kind="jitter", how={"delay_s": 0.003}, reaction="late answers are used and counted",
                  counted=("commands_late_or_lost",))  # fmt: skip
        yield Row(device=ARM, direction=direction, kind="duplication", reaction="the second is refused by E2E, counted",
                  counted=("state_frames_rejected",) if direction == TO_CONTROLLER else ("commands_rejected",))  # fmt: skip
        yield Row(device=ARM, direction=direction, kind="reordering", how={"probability": 0.1}, reaction="the late one is refused, counted",
                  counted=("state_frames_rejected", "commands_rejected"))  # fmt: skip
    yield Row(device=ARM, direction=TO_CONTROLLER, kind="out_of_range", how={"probability": 0.05}, stop="its range is", within=0.1,
              reaction="a joint beyond its range is no error of the link: stop on the first")  # fmt: skip
    yield Row(device=ARM, direction=TO_DEVICE, kind="out_of_range", stop=ARM_WATCHDOG, within=0.006, device_within=0.005,
              reaction="a torque beyond the arm's limits is not used, as if lost", counted=("commands_beyond_limits",))  # fmt: skip
    for jump in (1.0, -1.0):
        yield Row(device=ARM, direction=TO_CONTROLLER, kind="clock_jump", how={"jump_s": jump}, stop=ARM_SILENT, within=0.0225, device_within=0.0065,
                  reaction="cycle numbers ahead are lost cycles: stop at once" if jump > 0 else "cycle numbers of the past are refused: " + lost_answers)  # fmt: skip
    yield Row(device=ARM, direction=TO_DEVICE, kind="clock_jump", stop=ARM_WATCHDOG, within=0.006, device_within=0.005,
              reaction="answers to cycles that never were are none: the arm's watchdog")  # fmt: skip
    yield Row(
        device=ARM,
        kind="bus_off",
        stop=ARM_SILENT,
        within=0.0225,
        device_within=0.0055,
        reaction=lost_answers,
    )
    yield Row(device=ARM, kind="hung", stop=ARM_SILENT, within=0.0225,
              reaction="the controller after 20 cycles, and it says that the arm has not confirmed to be at rest: its last torque acts on; "
                       "a real arm needs a watchdog below its controller")  # fmt: skip
    yield Row(device=ARM, kind="hung", how={"duration_s": 0.01}, counted=("cycles_lost",),
              reaction="held over: less than 20 cycles, in which its own time stood still, too")  # fmt: skip
    yield Row(
        device=ARM,
        kind="dead",
        stop=ARM_SILENT,
        within=0.0225,
        device_within=0.0015,
        reaction="brakes without power; the controller after 20 cycles",
    )
    yield Row(device=ARM, kind="device_fault", stop="the arm went to fault by itself", within=0.0025, device_within=0.0015,
              reaction="brakes; the controller stops on the arm's word")  # fmt: skip


def _base_rows() -> Iterator[Row]:
    for share, direction, row in (
        (0.01, TO_CONTROLLER, {"reaction": "two in a row, or three within 0.2 s: some 4.5 s on average", "stop": BASE_SILENT, "within": 15.0, "lasts": 15.0, "seed": 3}),
        (0.05, TO_CONTROLLER, {"reaction": "two in a row, or three within 0.2 s: some 0.2 s on average", "stop": BASE_SILENT, "within": 2.0, "lasts": 2.1}),
        (0.2, TO_CONTROLLER, {"reaction": "two in a row, or three within 0.2 s: within some cycles", "stop": BASE_SILENT, "within": 0.5, "lasts": 0.6}),
        (0.01, TO_DEVICE, {"reaction": "the base follows the next one", "counted": ("setpoints_skipped",), "lasts": 2.0}),
        (0.05, TO_DEVICE, {"reaction": "the base follows the next one", "counted": ("setpoints_skipped",), "lasts": 2.0}),
        (0.2, TO_DEVICE, {"reaction": "the base follows the next one; five in a row (its watchdog) come once in 15 s on average",
                          "counted": ("setpoints_skipped",), "lasts": 1.0}),
    ):  # fmt: skip
        yield Row(device=BASE, direction=direction, kind="loss", how={"probability": share}, **row)  # type: ignore[arg-type]
    for kind, how in (("cut", {}), ("flipped_bits", {"bits": 1}), ("flipped_bits", {"bits": 8}), ("wrong_data_id", {}), ("frozen_counter", {}),
                      ("stale_stamp", {}), ("not_a_number", {}), ("out_of_range", {})):  # fmt: skip
        prefix = "" if kind == "cut" else "refused, as if lost: "
        yield Row(device=BASE, direction=TO_CONTROLLER, kind=kind, how=how, stop=BASE_SILENT, within=0.02,
                  reaction=prefix + "two cycles in a row")  # fmt: skip
        yield Row(device=BASE, direction=TO_DEVICE, kind=kind, how=how, stop=BASE_WATCHDOG, within=0.028, device_within=0.026,
                  reaction=prefix + "the base's watchdog after 20 ms, which it says; a base that does not say it: following error")  # fmt: skip
    yield Row(
        device=BASE,
        kind="cut",
        how={"duration_s": 0.004},
        reaction="one cycle is lost, held over and counted",
        counted=("cycles_lost", "samples_skipped"),
    )
    yield Row(
        device=BASE,
        direction=TO_CONTROLLER,
        kind="delay",
        how={"delay_s": 0.003},
        reaction="older measurements; watched is their age",
    )
    yield Row(device=BASE, direction=TO_CONTROLLER, kind="delay", how={"delay_s": 0.05}, stop=f"old, its limit is 0.02 s|{BASE_SILENT}", within=0.03,
              reaction="lost cycles while they stay away; measurements later than the quickest by the age limit are too old")  # fmt: skip
    yield Row(
        device=BASE,
        direction=TO_DEVICE,
        kind="delay",
        how={"delay_s": 0.01},
        reaction="the base follows later; watched is the following error",
    )
    yield Row(device=BASE, direction=TO_DEVICE, kind="delay", how={"delay_s": 0.05}, stop=BASE_WATCHDOG, within=0.03, device_within=0.026,
              reaction="the base's watchdog after 20 ms")  # fmt: skip
    for direction in (TO_CONTROLLER, TO_DEVICE):
        yield Row(
            device=BASE,
            direction=direction,
            kind="jitter",
            how={"delay_s": 0.003},
            reaction="the freshest is used",
        )
        yield Row(
            device=BASE,
            direction=direction,
            kind="duplication",
            reaction="the second is refused or overwrites the first",
        )
    yield Row(device=BASE, direction=TO_CONTROLLER, kind="reordering", stop=BASE_SILENT, within=0.06,
              reaction="only the freshest is kept, and that is the older one: every other cycle is lost")  # fmt: skip
    yield Row(
        device=BASE,
        direction=TO_DEVICE,
        kind="reordering",
        reaction="every other set point is followed",
        counted=("setpoints_refused", "setpoints_skipped"),
    )
    set_to = "a clock set {} is noticed and counted; ages are counted anew"
    for direction in (TO_CONTROLLER, TO_DEVICE):
        yield Row(device=BASE, direction=direction, kind="clock_jump", how={"jump_s": 3600.0}, reaction=set_to.format("forward"),
                  counted=("clock_steps",))  # fmt: skip
        yield Row(device=BASE, direction=direction, kind="clock_jump", how={"jump_s": -3600.0}, reaction=set_to.format("back"),
                  counted=("clock_steps",))  # fmt: skip
        yield Row(device=BASE, direction=direction, kind="clock_jump", how={"jump_s": 3600.0, "duration_s": 0.1},
                  reaction=set_to.format("back"), counted=("clock_steps",))  # fmt: skip
    yield Row(
        device=BASE, kind="hung", stop=BASE_SILENT, within=0.02, reaction="two cycles in a row"
    )
    yield Row(
        device=BASE,
        kind="dead",
        stop=BASE_SILENT,
        within=0.02,
        reaction="it stands; two cycles in a row",
    )


ROWS = (*_arm_rows(), *_base_rows())

_FACILITY, _STOPS, _TWO, _RUNS, _KILLED = (
    "tests/facility/test_process_faults.py",
    "tests/facility/test_stops_stay.py",
    "tests/facility/test_two_devices.py",
    "tests/recording/test_runs.py",
    "tests/recording/test_killed.py",
)
PROCESS_ROWS = (
    ProcessRow(what="SIGKILL of the controllers", reaction="the arm's own watchdog: damped ramp-down, brakes; the base holds its place",
               within="5 cycles; base 20 ms", test="tests/facility/test_real_time.py::test_the_arm_is_in_safe_stop_within_five_cycles_after_sigkill_of_the_controllers_and_the_base_holds"),
    ProcessRow(what="SIGSTOP of the controllers for 2.5 s", reaction="as SIGKILL; continued, they stop because they were held up, and nothing gets power again",
               within="5 cycles; base 20 ms", test=f"{_FACILITY}::test_suspended_controllers_never_enable_the_power_of_a_braked_arm_again"),
    ProcessRow(what="controller overrun: one cycle takes 50 ms", reaction="the arm's own watchdog; the loop says that it was held up",
               within="5 cycles", test=f"{_FACILITY}::test_the_loop_reports_an_overrun_of_the_controllers_as_the_cause"),
    ProcessRow(what="the same, with a loop that forgives it", reaction="the arm's own watchdog, which the controllers learn from its next frame",
               within="5 cycles", test=f"{_FACILITY}::test_the_watchdog_of_the_arm_stops_it_after_an_overrun_of_the_controllers"),
    ProcessRow(what="SIGKILL of the facility", reaction="20 lost cycles; says that the arm has not confirmed to be at rest", within="21.5 ms",
               test="tests/facility/test_real_time.py::test_the_controller_stops_in_order_after_sigkill_of_the_facility"),
    ProcessRow(what="SIGSTOP of the facility", reaction="the same; when it goes on, it brakes by its watchdog", within="21.5 ms",
               test=f"{_FACILITY}::test_a_suspended_facility_stops_the_controllers_and_brakes_after_it_resumes"),
    ProcessRow(what="20 % loss both ways over real sockets", reaction="the arm's own watchdog; nothing that was changed or lost is used",
               within="some 90 cycles on average", test=f"{_FACILITY}::test_corrupted_frames_on_real_sockets_are_never_used"),
    ProcessRow(what="a torque frame after the brake command, or any other of its session", reaction="the arm stays inactive and braked; counted",
               within="", test=f"{_STOPS}::test_frames_after_the_brake_command_cause_no_motion"),
    ProcessRow(what="set points held up for 0.8 s on the way", reaction="the base's watchdog, and the controllers when its token is withdrawn; what comes late activates nothing",
               within="its watchdog", test=f"{_STOPS}::test_delayed_set_points_do_not_activate_a_stopped_base"),
    ProcessRow(what="set points held up from the first one on", reaction="the controllers give up; what comes late activates nothing", within="3 s",
               test=f"{_STOPS}::test_set_points_that_arrive_after_the_end_of_their_loop_do_not_activate"),
    ProcessRow(what="two arms on one channel", reaction="refused before activation, as two senders of the state frame", within="40 cycles",
               test=f"{_TWO}::test_two_arms_on_one_channel_are_reported_and_not_activated"),
    ProcessRow(what="a second arm appears", reaction="the loop stops and names it", within="30 cycles",
               test=f"{_TWO}::test_a_second_arm_stops_the_running_loop_and_is_reported"),
    ProcessRow(what="two base robots on one topic", reaction="refused before activation, both named", within="25 samples",
               test=f"{_TWO}::test_two_base_robots_on_one_topic_are_reported_and_not_commanded"),
    ProcessRow(what="a second base robot appears", reaction="the loop stops and names it", within="its announcement, or 20 samples",
               test=f"{_TWO}::test_a_second_base_robot_stops_the_running_loop_and_is_reported"),
    ProcessRow(what="a base robot that reports other frames", reaction="refused by --check with the names of both", within="3 s",
               test=f"{_TWO}::test_a_base_with_other_frames_is_rejected_by_a_check_with_both_names"),
    ProcessRow(what="the base's clock is set back by 1 s", reaction="goes on, counted", within="",
               test=f"{_FACILITY}::test_a_base_continues_after_its_clock_is_set_back_and_the_step_is_counted"),
    ProcessRow(what="a flood of frames of another node, then SIGTERM", reaction="the loop answers on and stops in order", within="2 s more than without; brakes 0.1 s",
               test=f"{_STOPS}::test_a_flood_of_frames_does_not_delay_the_stop"),
    ProcessRow(what="SIGTERM or SIGINT before activation", reaction="the process ends", within="1 s",
               test="tests/facility/test_real_time.py::test_a_signal_ends_the_wait_for_the_arm_immediately"),
    ProcessRow(what="the disk of the results is full, then SIGINT", reaction="the reason is said before anything about files, and stop.json has it", within="at the stop",
               test=f"{_STOPS}::test_with_a_full_disk_the_reason_is_printed_once_and_stop_json_is_complete"),
    ProcessRow(what="the disk is full while recording", reaction="told once; the loop goes on; what was written is whole, the last 2 s are written elsewhere or stay in the ring",
               within="its next write", test=f"{_RUNS}::test_a_full_disk_is_told_once_and_what_was_written_is_kept"),
    ProcessRow(what="the directory of the recording vanishes", reaction="told once; the loop goes on; it is made again for the last 2 s",
               within="its next write", test=f"{_RUNS}::test_a_vanished_directory_is_told_and_the_loop_goes_on"),
    ProcessRow(what="SIGKILL of the recorder", reaction="the loop goes on, says so at its end, and writes the last 2 s and what the recording lacks of the last 8 s",
               within="at the stop", test=f"{_KILLED}::test_a_killed_recorder_costs_the_end_of_the_recording_and_the_loop_writes_its_last_seconds"),
    ProcessRow(what="SIGSTOP of the recorder", reaction="the loop goes on; up to 8 s are caught up with, beyond that rows are counted as lost",
               within="8 s", test=f"{_RUNS}::test_a_recorder_that_is_held_up_loses_nothing_and_holds_nobody_up"),
    ProcessRow(what="SIGKILL of controllers and recorder", reaction="as SIGKILL of the controllers; the next start, or `freeflyer recover`, saves all that was not written yet",
               within="8 s of ring", test=f"{_KILLED}::test_with_both_killed_the_next_start_saves_the_last_seconds_and_nothing_is_lost"),
    ProcessRow(what="this machine's clock is set back while recording", reaction="the loop does not see it; recordings' times go on; the step is named with its size",
               within="0.05 s", test="tests/recording/test_clock_steps.py::test_a_set_wall_clock_is_named_and_the_times_go_on_by_the_tick"),
    ProcessRow(what="the disk is full at the start", reaction="refused before anything is opened; an earlier run's reason is kept",
               within="the start", test="tests/recording/test_stop_notice.py::test_a_disk_that_is_full_at_the_start_is_refused_and_an_earlier_stop_json_is_kept"),
    ProcessRow(what="the terminal is closed, or a second signal comes during the stop", reaction="an orderly stop, which no further signal interrupts",
               within="as SIGTERM", test="tests/facility/test_stops.py::test_a_second_signal_does_not_interrupt_the_stop"),
)  # fmt: skip


def _document() -> Iterator[str]:
    sys.path.append(str(Path(__file__).parents[1]))  # what the tests share
    from test_fault_matrix import observed, reaction_times

    yield "# Fault matrix"
    yield ""
    yield "*Made by `python tests/faults/fault_matrix.py`, which runs every row; do not edit.*"
    yield ""
    yield from _INTRODUCTION.strip().splitlines()
    for device, title in ((ARM, "The arm on CAN"), (BASE, "The base robot on Zenoh")):
        yield from ("", f"## {title}", "")
        yield "| fault | direction | reaction | ends the loop | within | found | the device itself within | found |"
        yield "|---|---|---|---|---|---|---|---|"
        for row in (row for row in ROWS if row.device == device):
            decided, by_itself = reaction_times(row, observed(row))
            *cells, device_within = stated(row).split("|")
            found = _ms(decided) if row.stop else ""
            yield (
                "| "
                + " | ".join(
                    [*cells, found, device_within, _ms(by_itself) if row.device_within else ""]
                )
                + " |"
            )
    yield from ("", "## Processes and disks", "")
    yield "Real processes over real sockets."
    yield ""
    yield "| what happens | reaction | within | test |"
    yield "|---|---|---|---|"
    for process in PROCESS_ROWS:
        yield f"| {process.what} | {process.reaction} | {process.within} | `{process.test}` |"


_INTRODUCTION = """
What the facility's links, devices and processes may do, what then happens, and by when. Every row is a test with a seed
(`tests/faults/test_fault_matrix.py`): the shipped `facility` with every rule at its default, both ends in virtual time
(`freeflyer hil --accelerated`), where the same frames, samples, limits, monitors and state machines give the same instants every time.
*Within* is what the test demands, *found* what this run gave, from the fault's begin on. In every row, too: no value that the other side has
not sent is used, no command is beyond its limits or NaN, no state is illegal, no device becomes active a second time or after the loop's
stop has begun, and at the end the arm is braked and the base holds its place.

A stop is a reaction. After it the controllers ramp the torque down (0.25 s), the arm brakes, and the base holds; an arm that does not
hear them does so by itself. Faults begin 0.1 s after activation and last to the end, unless a duration is named.
"""


def stated(row: Row) -> str:
    """What the row states, its cells joined by |."""
    ends = "stops" if row.stop else "goes on"
    return "|".join(
        [
            _said(row),
            row.direction.replace("_", " "),
            row.reaction,
            ends,
            _ms(row.within),
            _ms(row.device_within),
        ]
    )


def _ms(time: float | None) -> str:
    if time is None:
        return ""
    return f"{time:.3g} s" if time >= 1.0 else f"{1e3 * time:.4g} ms"


def _said(row: Row) -> str:
    how = {
        "probability": "{:.0%}",
        "bits": "{:g} bit each",
        "delay_s": "{:g} s",
        "duration_s": "for {:g} s",
        "jump_s": "by {:+g} s",
    }
    return " ".join(
        [row.kind.replace("_", " "), *(how[key].format(value) for key, value in row.how.items())]
    )


if __name__ == "__main__":
    for line in _document():
        print(line, flush=True)
