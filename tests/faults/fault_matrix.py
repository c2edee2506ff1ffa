"""Fault matrix: every fault, its required reaction and the longest time of the reaction.

The tests run these rows. `python tests/faults/fault_matrix.py > docs/fault_matrix.md` writes the
document.
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
    """A fault and its required reaction.

    `stop`: regular expression for the reason of the stop; None: the loop continues.
    `within`: longest time [s] from the start of the fault to the stop of the loop.
    `device_within`: longest time [s] until the device itself is safe, if it has a reaction of its
    own. `counted`: counters, of which at least one must not be zero.
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
    """Longest duration of the run after the start of the fault [s]."""
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
    """A fault of a process or its disk; `test` is the name of the test, FILE::FUNCTION."""

    what: str
    reaction: str
    within: str
    test: str


def _arm_rows() -> Iterator[Row]:
    # Lost packets.
    lost_answers = "late answers: the arm's watchdog after 4 cycles; the controller after 20, or when the arm reports it"
    refused = "rejected by E2E, as if lost: "
    for share, direction, row in (
        (0.01, TO_CONTROLLER, {"reaction": "the last values are used, counted", "lasts": 2.0}),
        (0.05, TO_CONTROLLER, {"reaction": "the last values are used, counted", "lasts": 2.0}),
        (0.2, TO_CONTROLLER, {"reaction": "4 cycles without an answer occur after 0.8 s on average; then the arm's watchdog",
                              "stop": ARM_WATCHDOG, "within": 5.0, "lasts": 6.0}),
        (0.01, TO_DEVICE, {"reaction": "the last command remains, counted", "lasts": 2.0}),
        (0.05, TO_DEVICE, {"reaction": "the last command remains, counted", "lasts": 2.0}),
        (0.2, TO_DEVICE, {"reaction": "as to the controller: 0.8 s on average, then the arm's watchdog",
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
    # Faults that make every packet of a direction unusable.
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
                  reaction=prefix + "the arm's watchdog after 4 cycles, which the arm reports", counted=("commands_late_or_lost",))  # fmt: skip
    yield Row(
        device=ARM,
        direction=BOTH,
        kind="cut",
        how={"duration_s": 0.002},
        reaction="the last values are used, counted",
        counted=("cycles_lost",),
    )
    yield Row(device=ARM, direction=BOTH, kind="cut", how={"duration_s": 0.015}, stop=ARM_WATCHDOG, within=0.018, device_within=0.0055,
              reaction="the arm's watchdog after 4 cycles; the controller receives the new state when the link is back")  # fmt: skip
    # Delayed, duplicated and reordered packets.
    for direction in (TO_CONTROLLER, TO_DEVICE):
        yield Row(device=ARM, direction=direction, kind="delay", how={"delay_s": 0.002}, reaction="late answers are used and counted",
                  counted=("commands_late_or_lost",))  # fmt: skip
        yield Row(device=ARM, direction=direction, kind="delay", how={"delay_s": 0.01}, stop=f"{ARM_WATCHDOG}|{ARM_SILENT}", within=0.016,
                  device_within=0.0065, reaction="answers that are 4 cycles late are ignored: the arm's watchdog")  # fmt: skip
        yield Row(device=ARM, direction=direction, kind="jitter", how={"delay_s": 0.003}, reaction="late answers are used and counted",
                  counted=("commands_late_or_lost",))  # fmt: skip
        yield Row(device=ARM, direction=direction, kind="duplication", reaction="the second packet is rejected by E2E, counted",
                  counted=("state_frames_rejected",) if direction == TO_CONTROLLER else ("commands_rejected",))  # fmt: skip
        yield Row(device=ARM, direction=direction, kind="reordering", how={"probability": 0.1}, reaction="the late packet is rejected, counted",
                  counted=("state_frames_rejected", "commands_rejected"))  # fmt: skip
    # Wrong values and clocks.
    yield Row(device=ARM, direction=TO_CONTROLLER, kind="out_of_range", how={"probability": 0.05}, stop="its range is", within=0.1,
              reaction="a joint beyond its range is not a link error: stop at the first value")  # fmt: skip
    yield Row(device=ARM, direction=TO_DEVICE, kind="out_of_range", stop=ARM_WATCHDOG, within=0.006, device_within=0.005,
              reaction="a torque beyond the arm's limits is rejected, as if lost", counted=("commands_beyond_limits",))  # fmt: skip
    for jump in (1.0, -1.0):
        yield Row(device=ARM, direction=TO_CONTROLLER, kind="clock_jump", how={"jump_s": jump}, stop=ARM_SILENT, within=0.0225, device_within=0.0065,
                  reaction="higher cycle numbers count as lost cycles: immediate stop" if jump > 0 else "old cycle numbers are rejected: " + lost_answers)  # fmt: skip
    yield Row(device=ARM, direction=TO_DEVICE, kind="clock_jump", stop=ARM_WATCHDOG, within=0.006, device_within=0.005,
              reaction="answers to unknown cycles are ignored: the arm's watchdog")  # fmt: skip
    # Faults of the arm itself.
    yield Row(
        device=ARM,
        kind="bus_off",
        stop=ARM_SILENT,
        within=0.0225,
        device_within=0.0055,
        reaction=lost_answers,
    )
    yield Row(device=ARM, kind="hung", stop=ARM_SILENT, within=0.0225,
              reaction="the controller after 20 cycles; it reports that the arm has not confirmed standstill. The arm's last torque remains; "
                       "a real arm needs a watchdog below its controller")  # fmt: skip
    yield Row(device=ARM, kind="hung", how={"duration_s": 0.01}, counted=("cycles_lost",),
              reaction="the last values are used: fewer than 20 cycles, in which the arm's own cycle count stands still")  # fmt: skip
    yield Row(
        device=ARM,
        kind="dead",
        stop=ARM_SILENT,
        within=0.0225,
        device_within=0.0015,
        reaction="brakes without power; the controller after 20 cycles",
    )
    yield Row(device=ARM, kind="device_fault", stop="the arm went to fault by itself", within=0.0025, device_within=0.0015,
              reaction="brakes; the controller stops when the arm reports it")  # fmt: skip


def _base_rows() -> Iterator[Row]:
    # Lost packets.
    for share, direction, row in (
        (0.01, TO_CONTROLLER, {"reaction": "two in a row, or three within 0.2 s: 4.5 s on average", "stop": BASE_SILENT, "within": 15.0, "lasts": 15.0, "seed": 3}),
        (0.05, TO_CONTROLLER, {"reaction": "two in a row, or three within 0.2 s: 0.2 s on average", "stop": BASE_SILENT, "within": 2.0, "lasts": 2.1}),
        (0.2, TO_CONTROLLER, {"reaction": "two in a row, or three within 0.2 s: within a few cycles", "stop": BASE_SILENT, "within": 0.5, "lasts": 0.6}),
        (0.01, TO_DEVICE, {"reaction": "the base follows the next set point", "counted": ("setpoints_skipped",), "lasts": 2.0}),
        (0.05, TO_DEVICE, {"reaction": "the base follows the next set point", "counted": ("setpoints_skipped",), "lasts": 2.0}),
        (0.2, TO_DEVICE, {"reaction": "the base follows the next set point; five lost in a row (its watchdog) occur once in 15 s on average",
                          "counted": ("setpoints_skipped",), "lasts": 1.0}),
    ):  # fmt: skip
        yield Row(device=BASE, direction=direction, kind="loss", how={"probability": share}, **row)  # type: ignore[arg-type]
    # Faults that make every packet of a direction unusable.
    for kind, how in (("cut", {}), ("flipped_bits", {"bits": 1}), ("flipped_bits", {"bits": 8}), ("wrong_data_id", {}), ("frozen_counter", {}),
                      ("stale_stamp", {}), ("not_a_number", {}), ("out_of_range", {})):  # fmt: skip
        prefix = "" if kind == "cut" else "rejected, as if lost: "
        yield Row(device=BASE, direction=TO_CONTROLLER, kind=kind, how=how, stop=BASE_SILENT, within=0.02,
                  reaction=prefix + "two cycles in a row")  # fmt: skip
        yield Row(device=BASE, direction=TO_DEVICE, kind=kind, how=how, stop=BASE_WATCHDOG, within=0.028, device_within=0.026,
                  reaction=prefix + "the base's watchdog after 20 ms, which the base reports; without a report: following error")  # fmt: skip
    yield Row(
        device=BASE,
        kind="cut",
        how={"duration_s": 0.004},
        reaction="one cycle is lost and counted; the last values are used",
        counted=("cycles_lost", "samples_skipped"),
    )
    # Delayed, duplicated and reordered packets.
    yield Row(
        device=BASE,
        direction=TO_CONTROLLER,
        kind="delay",
        how={"delay_s": 0.003},
        reaction="older measurements; their age is monitored",
    )
    yield Row(device=BASE, direction=TO_CONTROLLER, kind="delay", how={"delay_s": 0.05}, stop=f"old, its limit is 0.02 s|{BASE_SILENT}", within=0.03,
              reaction="lost cycles until the first delayed measurement; a measurement beyond the age limit is too old")  # fmt: skip
    yield Row(
        device=BASE,
        direction=TO_DEVICE,
        kind="delay",
        how={"delay_s": 0.01},
        reaction="the base follows later; the following error is monitored",
    )
    yield Row(device=BASE, direction=TO_DEVICE, kind="delay", how={"delay_s": 0.05}, stop=BASE_WATCHDOG, within=0.03, device_within=0.026,
              reaction="the base's watchdog after 20 ms")  # fmt: skip
    for direction in (TO_CONTROLLER, TO_DEVICE):
        yield Row(
            device=BASE,
            direction=direction,
            kind="jitter",
            how={"delay_s": 0.003},
            reaction="the latest packet is used",
        )
        yield Row(
            device=BASE,
            direction=direction,
            kind="duplication",
            reaction="the second packet is rejected or overwrites the first",
        )
    yield Row(device=BASE, direction=TO_CONTROLLER, kind="reordering", stop=BASE_SILENT, within=0.06,
              reaction="only the last received packet is kept, which is the older one: every second cycle is lost")  # fmt: skip
    yield Row(
        device=BASE,
        direction=TO_DEVICE,
        kind="reordering",
        reaction="every second set point is followed",
        counted=("setpoints_refused", "setpoints_skipped"),
    )
    # Wrong clocks.
    set_to = "a clock set {} is detected and counted; the measurement of ages restarts"
    for direction in (TO_CONTROLLER, TO_DEVICE):
        yield Row(device=BASE, direction=direction, kind="clock_jump", how={"jump_s": 3600.0}, reaction=set_to.format("forward"),
                  counted=("clock_steps",))  # fmt: skip
        yield Row(device=BASE, direction=direction, kind="clock_jump", how={"jump_s": -3600.0}, reaction=set_to.format("back"),
                  counted=("clock_steps",))  # fmt: skip
        yield Row(device=BASE, direction=direction, kind="clock_jump", how={"jump_s": 3600.0, "duration_s": 0.1},
                  reaction=set_to.format("back"), counted=("clock_steps",))  # fmt: skip
    # Faults of the base itself.
    yield Row(
        device=BASE, kind="hung", stop=BASE_SILENT, within=0.02, reaction="two cycles in a row"
    )
    yield Row(
        device=BASE,
        kind="dead",
        stop=BASE_SILENT,
        within=0.02,
        reaction="the base stands still; two cycles in a row",
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
    ProcessRow(what="SIGSTOP of the controllers for 2.5 s", reaction="as SIGKILL; after SIGCONT they stop because they were suspended; no device is activated again",
               within="5 cycles; base 20 ms", test=f"{_FACILITY}::test_suspended_controllers_never_enable_the_power_of_a_braked_arm_again"),
    ProcessRow(what="controller overrun: one cycle takes 50 ms", reaction="the arm's own watchdog; the loop reports the overrun",
               within="5 cycles", test=f"{_FACILITY}::test_the_loop_reports_an_overrun_of_the_controllers_as_the_cause"),
    ProcessRow(what="the same, with a loop that tolerates the overrun", reaction="the arm's own watchdog; the controllers receive its state with the next frame",
               within="5 cycles", test=f"{_FACILITY}::test_the_watchdog_of_the_arm_stops_it_after_an_overrun_of_the_controllers"),
    ProcessRow(what="SIGKILL of the facility", reaction="20 lost cycles; the loop reports that the arm has not confirmed standstill", within="21.5 ms",
               test="tests/facility/test_real_time.py::test_the_controller_stops_in_order_after_sigkill_of_the_facility"),
    ProcessRow(what="SIGSTOP of the facility", reaction="the same; after SIGCONT the arm brakes because of its watchdog", within="21.5 ms",
               test=f"{_FACILITY}::test_a_suspended_facility_stops_the_controllers_and_brakes_after_it_resumes"),
    ProcessRow(what="20 % loss both ways over real sockets", reaction="the arm's own watchdog; no changed packet is used",
               within="90 cycles on average", test=f"{_FACILITY}::test_corrupted_frames_on_real_sockets_are_never_used"),
    ProcessRow(what="a torque frame after the brake command, or another frame of its session", reaction="the arm stays inactive and braked; counted",
               within="", test=f"{_STOPS}::test_frames_after_the_brake_command_cause_no_motion"),
    ProcessRow(what="set points delayed for 0.8 s on the link", reaction="the base's watchdog; the controllers stop when its token is withdrawn; late set points activate nothing",
               within="its watchdog", test=f"{_STOPS}::test_delayed_set_points_do_not_activate_a_stopped_base"),
    ProcessRow(what="set points delayed from the first one on", reaction="the controllers stop waiting; late set points activate nothing", within="3 s",
               test=f"{_STOPS}::test_set_points_that_arrive_after_the_end_of_their_loop_do_not_activate"),
    ProcessRow(what="two arms on one channel", reaction="rejected before activation, because two nodes send the state frame", within="40 cycles",
               test=f"{_TWO}::test_two_arms_on_one_channel_are_reported_and_not_activated"),
    ProcessRow(what="a second arm appears", reaction="the loop stops and reports it", within="30 cycles",
               test=f"{_TWO}::test_a_second_arm_stops_the_running_loop_and_is_reported"),
    ProcessRow(what="two base robots on one topic", reaction="rejected before activation with the names of both", within="25 samples",
               test=f"{_TWO}::test_two_base_robots_on_one_topic_are_reported_and_not_commanded"),
    ProcessRow(what="a second base robot appears", reaction="the loop stops and reports its name", within="its announcement, or 20 samples",
               test=f"{_TWO}::test_a_second_base_robot_stops_the_running_loop_and_is_reported"),
    ProcessRow(what="a base robot that reports other frames", reaction="rejected by --check with both names", within="3 s",
               test=f"{_TWO}::test_a_base_with_other_frames_is_rejected_by_a_check_with_both_names"),
    ProcessRow(what="the base's clock is set back by 1 s", reaction="the loop continues; counted", within="",
               test=f"{_FACILITY}::test_a_base_continues_after_its_clock_is_set_back_and_the_step_is_counted"),
    ProcessRow(what="a flood of frames of another node, then SIGTERM", reaction="the loop continues to answer, then stops in order", within="2 s more than without; brakes 0.1 s",
               test=f"{_STOPS}::test_a_flood_of_frames_does_not_delay_the_stop"),
    ProcessRow(what="SIGTERM or SIGINT before activation", reaction="the process ends", within="1 s",
               test="tests/facility/test_real_time.py::test_a_signal_ends_the_wait_for_the_arm_immediately"),
    ProcessRow(what="the disk of the results is full, then SIGINT", reaction="the reason is printed before any message about files, and stop.json contains it", within="at the stop",
               test=f"{_STOPS}::test_with_a_full_disk_the_reason_is_printed_once_and_stop_json_is_complete"),
    ProcessRow(what="the disk is full while recording", reaction="reported once; the loop continues; the written part is intact; the last 2 s are written to another directory or stay in the ring",
               within="its next write", test=f"{_RUNS}::test_a_full_disk_is_reported_once_and_the_written_part_is_kept"),
    ProcessRow(what="the directory of the recording is deleted", reaction="reported once; the loop continues; the directory is created again for the last 2 s",
               within="its next write", test=f"{_RUNS}::test_a_deleted_directory_is_reported_and_the_loop_continues"),
    ProcessRow(what="SIGKILL of the recorder", reaction="the loop continues and reports it at its end; it writes the last 2 s, and what the recording lacks of the last 8 s",
               within="at the stop", test=f"{_KILLED}::test_after_a_killed_recorder_the_loop_writes_the_last_seconds_and_the_rest_of_the_ring"),
    ProcessRow(what="SIGSTOP of the recorder", reaction="the loop continues; up to 8 s are recorded later; older rows are counted as lost",
               within="8 s", test=f"{_RUNS}::test_a_suspended_recorder_loses_nothing_and_does_not_block_the_loop"),
    ProcessRow(what="SIGKILL of controllers and recorder", reaction="as SIGKILL of the controllers; the next start, or `freeflyer recover`, writes the data of the ring",
               within="8 s of ring", test=f"{_KILLED}::test_with_both_killed_the_next_start_saves_the_last_seconds_and_nothing_is_lost"),
    ProcessRow(what="this machine's clock is set back while recording", reaction="the loop is not affected; the times of the recording continue; the step is reported with its size",
               within="0.05 s", test="tests/recording/test_clock_steps.py::test_a_set_wall_clock_is_reported_and_the_times_continue_by_the_tick"),
    ProcessRow(what="the disk is full at the start", reaction="rejected before a device is opened; the reason of an earlier run is kept",
               within="the start", test="tests/recording/test_stop_notice.py::test_a_disk_that_is_full_at_the_start_is_rejected_and_an_earlier_stop_json_is_kept"),
    ProcessRow(what="the terminal is closed, or a second signal comes during the stop", reaction="an orderly stop; further signals do not interrupt it",
               within="as SIGTERM", test="tests/facility/test_stops.py::test_a_second_signal_does_not_interrupt_the_stop"),
)  # fmt: skip


def _document() -> Iterator[str]:
    sys.path.append(str(Path(__file__).parents[1]))  # modules of the tests
    from test_fault_matrix import observed, reaction_times

    yield "# Fault matrix"
    yield ""
    yield "*Generated by `python tests/faults/fault_matrix.py`, which runs every row; do not edit.*"
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
Faults of the facility's links, devices and processes, the reaction to each, and the time of the reaction. Every row is a test with a seed
(`tests/faults/test_fault_matrix.py`). The tests run the shipped scenario `facility` with default settings, host and facility in virtual time
(`freeflyer hil --accelerated`). Frames, samples, limits, monitors and state machines are those of real time, and the times are reproducible.
*Within* is the limit of the test. *Found* is the result of this run. Both count from the start of the fault. Every row also checks:

- no value is used that the other side has not sent,
- no command is NaN or beyond its limits,
- no state is illegal,
- no device becomes active twice, or after the stop of the loop has started,
- at the end the arm is braked and the base holds its position.

After a stop the controllers ramp the torque down (0.25 s), the arm brakes, and the base holds its position. An arm that receives no commands
does the same by itself. Faults start 0.1 s after activation and last to the end, unless a duration is given.
"""


def stated(row: Row) -> str:
    """Return the cells of the row without measured times, joined by |."""
    ends = "stops" if row.stop else "continues"
    return "|".join(
        [
            _title(row),
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


def _title(row: Row) -> str:
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
