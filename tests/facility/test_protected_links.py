"""`freeflyer facility` and `freeflyer hil` with certificates, and messages of rejected peers."""

from __future__ import annotations

import re
import shutil
import signal
from collections.abc import Callable, Iterator
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
from commands import run_command
from processes import (
    BASE_ALONE,
    PATIENT_FACILITY,
    PATIENT_LOOP,
    Process,
    Rig,
    events,
    free_port,
    rig,
)

from freeflyer_adapters.base.certificate_authority import HOSTS, CertificateAuthority
from freeflyer_adapters.base.certificates import Identity


def scenario(folder: Path, text: str) -> str:
    path = folder / "protected.toml"
    path.write_text(text)
    return str(path)


def certificates(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    code, error = run_command(
        capsys,
        "certificates",
        str(folder),
        "--name",
        "controller",
        "--name",
        "base_robot",
        "--observer",
        "observer",
    )
    assert code == 0, error


@pytest.mark.slow
def test_the_experiment_runs_over_tls(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    certificates(tmp_path / "certs", capsys)
    path = scenario(
        tmp_path, 'extends = "facility"\n[devices.base_robot]\ncertificates = "certs"\n'
    )
    with rig(tmp_path, path) as bench:
        bench.endpoint = f"tls/127.0.0.1:{free_port()}"
        facility = bench.facility(*PATIENT_FACILITY)
        assert "base_robot: TLS with certificate 'base_robot', valid until" in facility.text
        loop = bench.hil(*PATIENT_LOOP, "stop_s=1.0")
        assert loop.finish() == 0, loop.text
        assert "base_robot: TLS with certificate 'controller', valid until" in loop.text
        report = bench.facility_report(facility)
    assert bench.summary()["steps"]["arm_drive"] == 1000
    assert "inactive -> active: set points arrived" in events(report, "base_robot")


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Rig, Process]]:
    """One protected facility with only the base on a link. None of the tests may move it."""
    folder = tmp_path_factory.mktemp("protected")
    for name in ("certs", "rogue"):
        (folder / name).mkdir()
        authority = CertificateAuthority.new(folder / name)
        for owner, listens in (("controller", True), ("base_robot", True), ("observer", False)):
            authority.issue(Identity(folder / name, owner), days=1, hosts=HOSTS, may_listen=listens)
    shutil.copytree(folder / "certs", folder / "expired")
    known = CertificateAuthority.read(folder / "certs")
    long_ago = datetime.now(UTC) - timedelta(days=9)
    known.issue(
        Identity(folder / "expired", "controller"),
        days=2,
        hosts=HOSTS,
        may_listen=True,
        start=long_ago,
    )
    path = scenario(folder, BASE_ALONE + '[devices.base_robot]\ncertificates = "certs"\n')
    with rig(folder, path) as made:
        made.endpoint = f"tls/127.0.0.1:{free_port()}"
        facility = made.start(
            "facility",
            path,
            "--set",
            f'devices.base_robot.connect=["{made.endpoint}"]',
            "--out",
            str(folder / "facility"),
        )
        facility.wait_for("is there")
        yield made, facility
        report = made.facility_report(facility)
        assert not events(report, "base_robot"), "the base has accepted a command"


Refused = Callable[..., str]


@pytest.fixture
def refused(bench: tuple[Rig, Process], capsys: pytest.CaptureFixture[str]) -> Refused:
    """A function that runs `freeflyer hil`, expects exit code 2, and returns the message."""
    made, _ = bench

    def sentence(*settings: str, endpoint: str | None = None) -> str:
        sets = [
            f'devices.base_robot.connect=["{endpoint or made.endpoint}"]',
            "devices.base_robot.parameters.configure_timeout=1.0",
            *settings,
        ]
        overrides = [argument for setting in sets for argument in ("--set", setting)]
        out = str(made.folder / "hil")
        code, error = run_command(
            capsys, "hil", made.scenario, *overrides, "--no-view", "--no-real-time", "--out", out
        )
        assert code == 2, error
        return error

    return sentence


def test_a_missing_certificate_is_reported(refused: Refused, bench: tuple[Rig, Process]) -> None:
    found = refused('devices.base_robot.certificates=""')
    assert (
        "is encrypted, but no certificates are named; make certificates with `freeflyer certificates DIR`"
        in found
    )
    plain = bench[0].endpoint.replace("tls/", "tcp/")
    found = refused('devices.base_robot.certificates=""', endpoint=plain)
    assert re.search(
        r"no valid sample on .* within 1 s: TLS is used on tcp/127.0.0.1:\d+: `certificates` and tls/127.0.0.1:\d+ are expected",
        found,
    )


def test_another_authority_is_reported(refused: Refused, bench: tuple[Rig, Process]) -> None:
    found = refused(f"devices.base_robot.certificates={bench[0].folder / 'rogue'}")
    assert "'base_robot', was signed by another authority than ours" in found


def test_an_expired_certificate_is_reported(refused: Refused, bench: tuple[Rig, Process]) -> None:
    found = refused(f"devices.base_robot.certificates={bench[0].folder / 'expired'}")
    assert re.search(
        r"controller.pem expired on .* UTC; `freeflyer certificates .* --renew controller` makes a new certificate",
        found,
    )


def test_a_valid_certificate_without_the_right_to_command_is_reported(
    refused: Refused, bench: tuple[Rig, Process]
) -> None:
    found = refused('devices.base_robot.controller="observer"')
    assert (
        "base_robot accepts no commands from certificate 'observer', only from controller" in found
    )


def test_a_facility_without_a_valid_certificate_does_not_start(
    bench: tuple[Rig, Process], capsys: pytest.CaptureFixture[str]
) -> None:
    made, _ = bench
    code, error = run_command(
        capsys, "facility", made.scenario, "--set", 'devices.base_robot.connect=["tls/127.0.0.3:0"]'
    )
    assert code == 2
    assert (
        "is for localhost, 127.0.0.1, ::1, not for 127.0.0.3, so peers would reject the certificate on this host"
        in error
    )


@pytest.mark.slow
def test_an_unencrypted_link_causes_a_warning(tmp_path: Path) -> None:
    """The address is of TEST-NET-1: after the warning, the link cannot be opened."""
    path = scenario(tmp_path, BASE_ALONE + "[devices.base_robot]\ninsecure = true\n")
    with rig(tmp_path, path) as made:
        process = made.start(
            "facility", path, "--set", 'devices.base_robot.connect=["tcp/192.0.2.10:7447"]'
        )
        process.wait_for(
            "WARNING: tcp/192.0.2.10:7447 is not encrypted, so any peer that reaches this endpoint can command the robot"
        )
        process.send(signal.SIGINT)
        process.finish()
