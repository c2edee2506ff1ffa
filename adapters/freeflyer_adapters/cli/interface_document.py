"""Generator of the interface control document from the DBC, message definitions and settings.

Run `python -m freeflyer_adapters.cli.interface_document > docs/interface_control_document.md`.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import fields, replace
from pathlib import Path

from freeflyer_adapters.arm.frames import (
    CONSEQUENCES,
    MESSAGES,
    NEEDED,
    SHIPPED_DBC,
    ArmFrames,
    FrameMapping,
    Mode,
)
from freeflyer_adapters.base import access_control, rmw_zenoh, ros_messages
from freeflyer_adapters.base.options import LinkOptions
from freeflyer_adapters.can.bus_load import bus_load, frame_time
from freeflyer_adapters.can.second_sender import LISTEN
from freeflyer_adapters.can.signals import load
from freeflyer_adapters.device import parameters as device_parameters
from freeflyer_adapters.device.device import TRANSITIONS, LifeCycle
from freeflyer_adapters.device.parameters import Setting
from freeflyer_adapters.facility import can_faults, zenoh_faults
from freeflyer_adapters.facility.faults import DIRECTIONS, KINDS, Fault, RandomFaults
from freeflyer_adapters.facility.settings import KEYS as FACILITY

JOINTS = 7
CLASSIC_PDOS = 2 * 7
"""Number of process-data frames (PDOs) of seven CiA 402 drives in one cycle, with classic CAN.

For each drive, one PDO contains the set point and one PDO contains the actual value. A PDO has 8
bytes.
"""


def document() -> str:
    """Return the document (Markdown)."""
    can = [*_can(), *_dialogue(), *_missing_roles(), *_second_sender()]
    parts = [*_head(), *can, *_zenoh(), *_life_cycle(), *_settings(), *_facility()]
    return "\n".join(parts) + "\n"


def _head() -> Iterator[str]:
    yield "# Interface control document"
    yield ""
    yield (
        "This document defines the data on the links between the controllers (`freeflyer hil`) and a real or virtual facility. Do not edit this "
        "document: `python -m freeflyer_adapters.cli.interface_document` generates it from `adapters/freeflyer_adapters/arm/arm.dbc`, the message definitions "
        "and the settings."
    )


def _can() -> Iterator[str]:
    frames = ArmFrames(FrameMapping(), JOINTS)
    database = load(SHIPPED_DBC)
    yield "\n## Arm: CAN FD\n"
    yield (
        "The nominal bit rate is 1 Mbit/s, and the data bit rate is 5 Mbit/s (bit-rate switching). Both rates are settings of the CAN interface "
        "in python-can. AUTOSAR E2E profile 5 protects all frames. The E2E header is in the first three bytes of a frame. The header contains a CRC-16, "
        "and then an 8-bit counter. The CRC covers the data and the data ID. A frame is rejected if its CRC is wrong, if its counter is repeated, or if its "
        "counter is more than 50 ahead of the last counter. All numbers are little-endian."
    )
    yield "\n| frame | identifier | bytes | cycle | data ID | from | longest time on the bus |\n|---|---|---|---|---|---|---|"
    for kind in MESSAGES:
        message = database.get_message_by_name(MESSAGES[kind])
        taken = frame_time(message.length, True) * 1e6
        data_id = message.dbc.attributes["E2eDataId"].value
        yield (
            f"| `{message.name}` | 0x{message.frame_id:03X} | {message.length} | {message.cycle_time} ms | 0x{data_id:04X} | "
            f"{', '.join(message.senders)} | {taken:.0f} us |"
        )
    yield (
        f"\nA command frame and a state frame together take at most {100 * bus_load([(f.size, f.is_fd) for f in (frames.command, frames.state)], 1e-3):.0f} % of the bus time in a cycle of 1 ms. "
        f"This number includes all possible stuff bits. Classic CAN at 1 Mbit/s is not sufficient: {CLASSIC_PDOS} process-data frames of {JOINTS} CiA 402 drives would "
        f"take {100 * CLASSIC_PDOS * frame_time(8, False) / 1e-3:.0f} % of the bus time."
    )
    for kind in MESSAGES:
        message = database.get_message_by_name(MESSAGES[kind])
        yield f"\n### `{message.name}`\n\n{message.comment}\n"
        yield "| signal | first bit | bits | signed | resolution | range | unit | meaning |\n|---|---|---|---|---|---|---|---|"
        for signal in sorted(message.signals, key=lambda signal: signal.start):
            meaning = signal.comment or ""
            if signal.choices:
                meaning += ": " + ", ".join(
                    f"{number} {name}" for number, name in sorted(signal.choices.items())
                )
            low, high = signal.minimum, signal.maximum
            yield (
                f"| {signal.name} | {signal.start} | {signal.length} | {'yes' if signal.is_signed else 'no'} | {signal.scale:g} | "
                f"{low:.9g} ... {high:.9g} | {signal.unit or ''} | {meaning} |"
            )


def _dialogue() -> Iterator[str]:
    yield "\n### The dialogue\n"
    yield from (
        "1. At the start of every cycle, the arm sends `ArmState` with a new cycle number. This frame is the clock of the loop.",
        "2. The controller answers every state frame with one `ArmCommand` within the cycle. `AnsweredCycle` of this command repeats the cycle "
        "number of the state frame. The arm applies the torque in its next cycle, for one cycle.",
        "3. `EchoedCycle` of the next state frame reports which answer the arm has used. The controller counts late and missing answers. "
        "`CommandAge` reports the number of cycles since the last command.",
        f"4. Every activation has a new random session number in the signal `Controller`. A command with `Mode` {int(Mode.reset)} claims this number. "
        "If the arm has no session and the number is not used up (see item 7), the arm repeats the number in its following state frames (echo). "
        "If the arm is in the state *safe_stop* or *fault* and its brakes are engaged, the claim also changes the arm to the state *inactive*. "
        "The arm ignores all other numbers until the present session has sent no frame for one second.",
        f"5. A command with `Mode` {int(Mode.activate)} activates an arm in the state *inactive* under two conditions. First, the command contains the echoed number. "
        "Second, the command answers a state frame that contains the echo and is younger than the watchdog time of the arm. "
        "Therefore an old command frame cannot activate the arm.",
        f"6. `Mode` {int(Mode.torque)} commands the torques of an arm in the state *active*. In any other state, the arm ignores and counts such a command. "
        f"`Mode` {int(Mode.brake)} engages the brakes. `Mode` {int(Mode.idle)} keeps a session alive and causes no motion.",
        f"7. A session number is used up when the arm leaves the state *active* for any reason, or when a command with `Mode` {int(Mode.brake)} arrives. "
        "After this, no frame of that session enables the power again. An arm may lose its list of used numbers when the arm is switched off and on. "
        "In this case, the new cycle numbers of the arm must not continue from the old cycle numbers.",
        "8. The controller itself has a second interlock: the controller needs a permit to send any mode except "
        f"{int(Mode.idle)} and {int(Mode.brake)}. The permit is lost permanently at the first reason to stop. The permit is also lost after a suspension of the loop that is "
        "longer than the watchdog time of the arm (`watchdog_cycles`). It is also lost when the arm has reported the state *active* and then reports another state. "
        "The graded stop is an exception: without the permit, the controller ramps the torque down before the brakes engage. These torques are sent only if the arm has echoed one of the controller's own answers. "
        "This echo must be younger than the watchdog time.",
    )


def _missing_roles() -> Iterator[str]:
    yield "\n### What a DBC may lack\n"
    yield (
        "A role is the meaning that a signal has for this project. A DBC of a user must have the four joint signals and `cycle`. "
        "If one of the other roles is missing, a guarantee is lost. The table shows the effect of each missing role. If a role marked *explicit* is missing, "
        'the arm itself cannot reject an activation. In this case the scenario must set `activation = "implicit"`, and a torque '
        "frame activates the arm. `freeflyer hil` and `freeflyer hil --check` then print which commands this arm cannot reject. Only the interlock of the controller (item 8 of the dialogue) is left. "
        "This interlock alone is sufficient under two conditions. First, the link does not delay frames. Second, after a loss of state frames, the loop stops before the arm "
        "ends the session with its controller (`lost_consecutive`, `state_age_limit`).\n"
    )
    yield "| missing role | needed for | effect of the missing role |\n|---|---|---|"
    for name, lost in CONSEQUENCES.items():
        yield f"| `{name}` | {'*explicit*' if name in NEEDED else ''} | {lost} |"
    yield (
        "\nIf a DBC has every message name and signal name of the shipped profile, and the scenario has no mappings, the DBC is treated as the "
        "shipped profile. The command frame and the state frame must have different identifiers."
    )


def _second_sender() -> Iterator[str]:
    yield "\n### One arm, one controller\n"
    yield (
        f"Only one node may send frames with a given identifier (ISO 11898-1). The controller checks {LISTEN} state frames before it sends anything. In the loop, "
        "the controller checks all state frames. Two arms send two interleaved streams of frames, with correct checksums and different counters. "
        "Before activation, more than three state frames in two cycles also show that there are two arms. Two arms are rejected before activation. In a running loop, two arms are a reason to stop. Repeated, late and reordered frames, a frozen "
        "counter, and a jump of the counter are treated as faults of one sender. If three command frames of another sender arrive within 20 cycles, there is a second controller."
        "\n\nThe following cases are not detected: two arms with the same content and "
        "the same counter; a second sender at a sixteenth of the rate or less; more than two senders; frames without E2E protection and "
        "without a cycle number. `tests/links/test_second_sender.py` measures the detection time. The median is 15 frames of each sender. Without loss of "
        "frames, the maximum is 39 frames of each sender."
    )


def _zenoh() -> Iterator[str]:
    o = LinkOptions()
    yield "\n## Base robot: Zenoh\n"
    yield (
        "Both directions use `nav_msgs/msg/Odometry` in CDR, with the key expressions of ROS 2's rmw_zenoh. So a ROS 2 node can be the base robot. "
        "Messages are sent in little-endian byte order (encapsulation 00 01), and are read in both byte orders. `header.frame_id` is the inertial frame. "
        "`child_frame_id` is the frame of the base. By the message definition, the twist is expressed in the frame of the base. All covariances are 0."
    )
    yield "\n| topic | from | key expression | rate |\n|---|---|---|---|"
    for topic, sender in ((o.setpoint_topic, "controller"), (o.measured_topic, "base robot")):
        key = rmw_zenoh.topic_key(o.domain, topic, ros_messages.TYPE_NAME, ros_messages.TYPE_HASH)
        yield f"| `{topic}` | {sender} | `{key}` | 250 Hz |"
    yield (
        f"\nEvery sample has the attachment of rmw_zenoh ({rmw_zenoh.ATTACHMENT.size} bytes, little-endian). It contains the sequence number (int64), the source time stamp "
        "(int64, ns since the epoch), the length 16 (uint8) and the GID of the publisher (16 bytes). The GID is the global identifier of a publisher. "
        "A sample is used under the following conditions:\n\n"
        "- The attachment is complete.\n"
        "- The frame names are the frame names of the scenario (`frame`, `child_frame`).\n"
        "- The GID is the GID of the first sample.\n"
        "- The sequence number is greater than the last sequence number.\n"
        "- The time stamp differs from the last time stamp.\n\n"
        "Only differences of time stamps are used. If a later sample has an earlier time stamp, the clock of the sender was set back. This step of the clock "
        "is counted (`clock_steps`) and has no other effect. Only the latest sample is kept (RingChannel(1)). Samples are sent with priority REAL_TIME, express, "
        "and congestion control DROP. The liveliness tokens of rmw_zenoh announce publishers and subscriptions (QoS: best effort, keep last 1)."
    )
    yield (
        "\nCDR and rmw_zenoh have no checksum. Therefore the senders of this project put a checksum into the two option bytes of CDR's encapsulation "
        "header. Receivers without this checksum, for example a plain ROS 2 node, ignore these bytes. The checksum is the CRC-16 of E2E profile 5 (polynomial 0x1021, initial value 0xFFFF), most significant byte first. "
        "The checksum covers the first two bytes of the message, all bytes from the fifth byte on, and the attachment. Later versions of CDR use the two "
        "lowest bits for the padding size, so these two bits must be zero. The sender increments its time stamp by 1 ns until the two bits of the checksum are zero. "
        "If the first sample of a publisher has non-zero option bytes, every sample of this publisher must have a correct checksum. The option bytes of a "
        "plain ROS 2 node are zero, so the checksum of its samples is not checked."
    )
    yield from _zenoh_session(o)
    yield from _access_control(replace(o, certificates=Path()))


def _zenoh_session(o: LinkOptions) -> Iterator[str]:
    yield (
        "\nOdometry has no field for a session, so the publisher identifies the session. For every activation, the controller declares a new publisher with "
        "a new GID. At the stop, the controller undeclares this publisher. Odometry also does not report whether the base robot accepts a set point. A base robot may "
        f"report this by a liveliness token of this project, `{rmw_zenoh.obedience_token(o.domain, o.setpoint_topic, 'GID')}`. `GID` is the GID "
        "(hexadecimal) of the publisher in command, that is, the publisher whose set points are accepted. If there is no such publisher, "
        f"`{rmw_zenoh.NO_PUBLISHER}` replaces the GID. If the base robot has this token, the link has three further properties:\n\n"
        "- The controller does not activate if the token reports another publisher in command.\n"
        "- The controller activates the arm only after the base robot has accepted the set points of the controller.\n"
        "- The controller stops when the token is withdrawn.\n\n"
        "The virtual base robot has this token. It accepts a publisher after the set points of this publisher have arrived for 40 ms at the rate of their time stamps. "
        "Delayed set points arrive in a burst, so they do not pass this test. The virtual base robot rejects a publisher permanently in two cases. First, the publisher was in command, and the state *active* has ended. "
        "Second, the publisher has sent a set point while another publisher was in command. A set point is ignored if its delay is longer than the watchdog time. "
        "The delay is computed from differences of time stamps.\n\n"
        "With **a plain ROS 2 node**, only the interlock of the controller exists: after a stop or a suspension of the loop, the controller publishes nothing more. "
        "The node itself must meet the following requirements:\n\n"
        "- The node holds its pose if no set point arrives within its watchdog time.\n"
        "- The node ignores set points if their time stamps do not advance at the rate of their arrival.\n"
        "- The node ignores a publisher after a gap in the set points of this publisher. The GID or the middleware identifies the publisher.\n"
        "- The node does not resume motion when set points arrive again."
    )
    yield (
        "\nThe controller detects two publishers of the measured topic by their tokens, or by interleaved samples of two GIDs. Two publishers are rejected before activation. In a running "
        "loop, two publishers are a reason to stop. If a second publisher of the set-point topic appears, the reactions are the same. Peers that are connected only to the base robot do not receive the "
        "tokens of each other. In this case, the base robot ignores the second publisher, and the token of the base robot reports the first publisher."
    )
    yield (
        f"\nAll sessions are peers. By default, the controller listens on {', '.join(f'`{e}`' for e in o.listen)}, and the virtual base robot listens on "
        f"{', '.join(f'`{e}`' for e in o.connect)}. The controller connects to the virtual base robot. Multicast scouting and gossip "
        "are off, so only configured endpoints are used. Links to other machines use TLS or QUIC with certificates of both sides ([security](security.md))."
    )


def _access_control(o: LinkOptions) -> Iterator[str]:
    yield (
        f"\n### Access control\n\nWith certificates, Zenoh's access control on each end of the link permits only the messages of this table. The table uses the default names. "
        f"The controller is `{o.controller}`, which is the only commander. The robot is `{o.robot}`. A third-party base robot needs the rules in the rows of the "
        f"base robot. A router in front of this base robot can have these rules instead. By the token "
        f"`{rmw_zenoh.commander_token(o.domain, o.setpoint_topic, 'NAME')}`, the base robot can report that the controller with the certificate NAME may command it."
    )
    yield "\n| end of the link | certificates of the peer | flow | messages | key expressions |\n|---|---|---|---|---|"
    for end, protection in (
        ("base robot", access_control.robot_protection(o)),
        ("controller", access_control.controller_protection(o)),
    ):
        assert protection is not None
        access = protection.access
        names = {
            s["id"]: ", ".join(s.get("cert_common_names", ["every valid certificate"]))
            for s in access["subjects"]
        }
        certificates = {
            rule: names[subject]
            for policy in access["policies"]
            for subject in policy["subjects"]
            for rule in policy["rules"]
        }
        for rule in access["rules"]:
            keys = ", ".join(f"`{key}`" for key in rule["key_exprs"])
            yield f"| {end} | {certificates[rule['id']]} | {rule['flows'][0]} | {', '.join(rule['messages'])} | {keys} |"


def _life_cycle() -> Iterator[str]:
    yield "\n## Life cycle\n\nThe life cycle is the same for simulated, virtual and real devices.\n"
    yield "| state | number | possible next states |\n|---|---|---|"
    for state in LifeCycle:
        yield f"| {state.name} | {int(state)} | {', '.join(sorted(s.name for s in TRANSITIONS[state]))} |"


def _settings() -> Iterator[str]:
    yield "\n## Settings and limits of the controllers' side\n"
    yield (
        "These settings are in `[devices.NAME.parameters]` of a scenario. The column *effect* shows what happens if a limit is exceeded:\n\n"
        "- *clips*: the command is limited to the permitted range. Limited commands are counted and reported.\n"
        "- *stops*: the loop ends with the graded stop. The torque is ramped down with joint damping, and then the brakes engage.\n"
        "- *refuses*: the device is not activated.\n\n"
        "During lost cycles, the last measurement is held. For the arm, the last torque is also held. `[[limits]]` of the scenario defines further limits for the base "
        "wrench, and for the observed energies over a given time."
    )
    for title, rows in (
        ("Arm (`can_arm`)", device_parameters.ARM),
        ("Base robot (`zenoh_base`)", device_parameters.BASE),
    ):
        yield f"\n### {title}\n\n| setting | default | unit | effect | meaning |\n|---|---|---|---|---|"
        for row in rows:
            yield f"| `{row.name}` | {_default(row)} | {_units(row)} | {row.effect} | {row.description} |"
    yield (
        "\nThe shipped scenario takes the joint limits from the robot file through `manipulator_controller`. These limits are compared "
        "with the limits that the arm reports."
    )


def _default(setting: Setting) -> str:
    if setting.boolean:
        return "true" if setting.default[0] else "false"
    text = ", ".join(f"{value:.6g}" for value in setting.default)
    return f"{text} (each joint)" if setting.per_joint else text


def _units(setting: Setting) -> str:
    return {None: "", "1": ""}.get(setting.unit, str(setting.unit).replace(" ", ", "))


def _facility() -> Iterator[str]:
    yield "\n## Settings of the virtual facility\n"
    yield (
        "These settings are in `[facility]` of a scenario. The scenario also has the parameters of the models (friction, noise, delay, seeds), as parameters of the components `arm_drive` and "
        "`base_robot`. All these values are assumptions of this project, not values of a real facility.\n"
    )
    yield "| setting | default | meaning |\n|---|---|---|"
    for name, key in FACILITY.items():
        if key.default is not None:
            yield f"| `{name}` | {key.default:g} | {key.meaning} |"
    yield from _faults()


def _faults() -> Iterator[str]:
    yield "\n### Faults\n"
    yield (
        "`[[facility.faults]]` schedules faults. `[facility.random_faults]` ("
        + _defaults(RandomFaults())
        + ") draws random faults. "
        "Every fault has the keys `device` and `kind`. A fault may also have `direction` ("
        + ", ".join(DIRECTIONS)
        + "; default: both), `begin_s`, `duration_s`, and the keys of its kind. `begin_s` is measured from the first activation of the device in a session. "
        "Without `begin_s`, the fault is active from the start, also during the activation. "
        "All times are rounded to whole cycles of the facility. The [fault matrix](fault_matrix.md) shows the reactions to faults.\n"
    )
    yield "| kind | effect | keys | `can_arm` | `zenoh_base` | `cia402_arm` |\n|---|---|---|---|---|---|"
    supported_by = can_faults.FAULT_KINDS, zenoh_faults.FAULT_KINDS, can_faults.OF_DRIVES
    for name, kind in KINDS.items():
        takes = ", ".join(
            f"`{key}` ({getattr(Fault(kind=name, device=''), key):g})" for key in kind.takes
        )
        supported = ("yes" if name in kinds else "" for kinds in supported_by)
        yield f"| `{name}` | {kind.description} | {takes} | {' | '.join(supported)} |"


def _defaults(settings: RandomFaults) -> str:
    return ", ".join(
        f"`{f.name} = {list(v) if isinstance(v := getattr(settings, f.name), tuple) else v}`"
        for f in fields(settings)
    )


if __name__ == "__main__":
    print(document(), end="")
