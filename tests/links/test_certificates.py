"""The folder of certificates: files of the command, tested with OpenSSL, and invalid folders."""

from __future__ import annotations

import ipaddress
import os
import shutil
import ssl
import stat
from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
from commands import run_command
from hypothesis import assume, given
from hypothesis import strategies as st
from lab import Lab

from freeflyer.scenario import scenario
from freeflyer_adapters.base import certificates
from freeflyer_adapters.base import options as link_options
from freeflyer_adapters.base.access_control import robot_protection
from freeflyer_adapters.base.certificate_authority import HOSTS, CertificateAuthority
from freeflyer_adapters.base.certificates import Identity
from freeflyer_adapters.base.notices import notices
from freeflyer_adapters.base.session import open_session
from freeflyer_adapters.foundation.errors import DeviceError


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Lab:
    return Lab(tmp_path_factory.mktemp("lab"))


@pytest.fixture
def folder(lab: Lab, tmp_path: Path) -> Path:
    """A copy that a test may change."""
    return Path(shutil.copytree(lab.good, tmp_path / "certificates"))


# Files made by the command


def made(capsys: pytest.CaptureFixture[str], directory: Path, *arguments: str) -> str:
    code, error = run_command(capsys, "certificates", str(directory), *arguments)
    assert (code, error) == (0, "")
    return error


def handshake(server: Identity, client: Identity, host: str) -> None:
    """Execute a strict TLS handshake of OpenSSL in memory. Raises ssl.SSLError if it fails."""
    contexts = []
    for purpose, identity in ((ssl.PROTOCOL_TLS_SERVER, server), (ssl.PROTOCOL_TLS_CLIENT, client)):
        context = ssl.SSLContext(purpose)
        context.verify_flags |= ssl.VERIFY_X509_STRICT
        context.load_cert_chain(identity.certificate, identity.key)
        context.load_verify_locations(identity.authority)
        context.verify_mode = ssl.CERT_REQUIRED
        contexts.append(context)
    up, down = ssl.MemoryBIO(), ssl.MemoryBIO()
    ends = [
        contexts[0].wrap_bio(up, down, server_side=True),
        contexts[1].wrap_bio(down, up, server_hostname=host),
    ]
    waiting = list(ends)
    for _ in range(10):
        for end in list(waiting):
            try:
                end.do_handshake()
                waiting.remove(end)
            except ssl.SSLWantReadError:
                pass
    assert not waiting


def test_openssl_accepts_the_certificates_and_an_observer_only_as_a_client(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    made(
        capsys,
        tmp_path / "c",
        "--name",
        "controller",
        "--name",
        "arm",
        "--observer",
        "watcher",
        "--host",
        "192.0.2.10",
        "--host",
        "lab.example",
    )
    ends = {name: Identity(tmp_path / "c", name) for name in ("controller", "arm", "watcher")}
    for host in ("127.0.0.1", "::1", "localhost", "192.0.2.10", "lab.example"):
        handshake(ends["arm"], ends["controller"], host)
        handshake(ends["arm"], ends["watcher"], host)
    with pytest.raises(ssl.SSLCertVerificationError, match="IP address mismatch"):
        handshake(ends["arm"], ends["controller"], "192.0.2.11")
    with pytest.raises(
        ssl.SSLCertVerificationError, match=r"(unsuitable|unsupported) certificate purpose"
    ):
        handshake(ends["watcher"], ends["controller"], "127.0.0.1")


def test_keys_and_their_folder_are_private_to_the_user(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    before = os.umask(0)
    try:
        made(capsys, tmp_path / "c")
    finally:
        os.umask(before)
    assert stat.S_IMODE((tmp_path / "c").stat().st_mode) == 0o700
    keys = sorted((tmp_path / "c").glob("*.key"))
    assert [path.stem for path in keys] == ["base_robot", "ca", "controller"]
    assert {stat.S_IMODE(path.stat().st_mode) for path in keys} == {0o600}
    assert sorted(path.suffix for path in (tmp_path / "c").iterdir()) == [".key"] * 3 + [".pem"] * 3


def test_the_command_adds_to_an_authority_and_overwrites_nothing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    directory = tmp_path / "c"
    made(capsys, directory)
    before = {path: path.read_bytes() for path in directory.iterdir()}
    made(capsys, directory, "--observer", "watcher")
    assert {path: path.read_bytes() for path in before} == before
    handshake(Identity(directory, "base_robot"), Identity(directory, "watcher"), "localhost")
    code, error = run_command(
        capsys, "certificates", str(directory), "--name", "new", "--name", "controller"
    )
    assert code == 2
    assert (
        "controller.pem exists already and is not overwritten; use --renew controller to replace this certificate and its key"
        in error
    )
    assert not (directory / "new.pem").exists()


def test_renewing_keeps_hosts_and_uses_and_makes_a_new_key(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    directory = tmp_path / "c"
    made(
        capsys,
        directory,
        "--name",
        "base_robot",
        "--name",
        "controller",
        "--observer",
        "watcher",
        "--host",
        "192.0.2.10",
        "--days",
        "1",
    )
    before = (directory / "base_robot.key").read_bytes()
    made(
        capsys,
        directory,
        "--renew",
        "base_robot",
        "--renew",
        "watcher",
        "--host",
        "192.0.2.11",
        "--days",
        "100",
    )
    assert (directory / "base_robot.key").read_bytes() != before
    for host in ("192.0.2.10", "192.0.2.11", "localhost"):
        handshake(Identity(directory, "base_robot"), Identity(directory, "watcher"), host)
    with pytest.raises(ssl.SSLCertVerificationError):
        handshake(Identity(directory, "watcher"), Identity(directory, "controller"), "192.0.2.11")
    found = certificates.check(Identity(directory, "base_robot"), "x")
    assert timedelta(days=99) < found.not_valid_after_utc - datetime.now(UTC) < timedelta(days=101)


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["--name", "a/b"], "'a/b' is not a valid certificate name"),
        (["--name", "ca"], "the name 'ca' is reserved"),
        (["--name", ""], "'' is not a valid certificate name"),
        (["--name", "x" * 65], "1 to 64 letters"),
        (["--name", "a", "--observer", "a"], "'a' is named more than once"),
        (["--host", "a b"], "neither a host name nor an address"),
        (["--host", "300.1.1.1"], "neither a host name nor an address"),
        (["--host=-x"], "neither a host name nor an address"),
        (["--days", "0"], "more than 0 and at most 3650 days"),
        (["--days", "nan"], "more than 0"),
        (["--days", "1e9"], "at most 3650"),
        (["--days", "soon"], "'soon' is not a number"),
        (["--renew", "controler"], "there is no"),
    ],
)
def test_a_wrong_argument_is_reported_in_one_sentence_and_makes_no_file(
    arguments: list[str], sentence: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    try:
        code, error = run_command(capsys, "certificates", str(tmp_path / "c"), *arguments)
    except SystemExit as end:  # raised by the parser
        code, error = int(str(end.code)), capsys.readouterr().err
    assert code == 2
    assert sentence in error
    assert not (tmp_path / "c").exists()


def test_an_invalid_authority_signs_nothing(
    folder: Path, lab: Lab, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def refused(directory: Path, sentence: str) -> None:
        code, error = run_command(capsys, "certificates", str(directory), "--name", "new")
        assert code == 2
        assert sentence in error
        assert not (directory / "new.pem").exists()

    file = tmp_path / "file"
    file.write_text("")
    refused(file, "is a file; a directory is expected")
    shutil.copy(lab.rogue / "ca.key", folder / "ca.key")
    refused(folder, "is not the key of")
    (folder / "ca.key").write_text("nonsense")
    refused(folder, "are not a PEM certificate and key")
    (folder / "ca.key").unlink()
    refused(folder, "ca.key is missing; the authority cannot sign without this file")
    (folder / "ca.pem").unlink()
    shutil.copy(lab.rogue / "ca.key", folder / "ca.key")
    refused(folder, "exists without its certificate and is not overwritten")


# Files that are rejected before a session is opened


def spoil_key_of_another(folder: Path, lab: Lab) -> None:
    shutil.copy(folder / "controller.key", folder / "base_robot.key")


def spoil_mode(folder: Path, lab: Lab) -> None:
    (folder / "base_robot.key").chmod(0o640)


def spoil_authority(folder: Path, lab: Lab) -> None:
    shutil.copy(lab.rogue / "ca.pem", folder / "ca.pem")


def spoil_age(folder: Path, lab: Lab) -> None:
    for suffix in ("pem", "key"):
        shutil.copy(lab.expired / f"base_robot.{suffix}", folder / f"base_robot.{suffix}")


def spoil_youth(folder: Path, lab: Lab) -> None:
    later = datetime.now(UTC) + timedelta(days=2)
    lab.authority.issue(
        Identity(folder, "base_robot"), days=1, hosts=HOSTS, may_listen=True, start=later
    )


def spoil_use(folder: Path, lab: Lab) -> None:
    lab.authority.issue(Identity(folder, "base_robot"), days=1, hosts=HOSTS, may_listen=False)


def spoil_host(folder: Path, lab: Lab) -> None:
    lab.authority.issue(
        Identity(folder, "base_robot"), days=1, hosts=["192.0.2.10"], may_listen=True
    )


def spoil_name(folder: Path, lab: Lab) -> None:
    for suffix in ("pem", "key"):
        shutil.copy(folder / f"controller.{suffix}", folder / f"base_robot.{suffix}")


def spoil_forged_issuer(folder: Path, lab: Lab) -> None:
    """Issue by another authority of the same name: only the signature differs."""
    forger = CertificateAuthority.read(lab.rogue)
    forger.certificate = CertificateAuthority.read(folder).certificate
    forger.issue(Identity(folder, "base_robot"), days=1, hosts=HOSTS, may_listen=True)


def without(name: str) -> Callable[[Path, Lab], None]:
    return lambda folder, lab: (folder / name).unlink()


def with_text(name: str, text: str) -> Callable[[Path, Lab], None]:
    return lambda folder, lab: (folder / name).write_text(text) and None  # type: ignore[func-returns-value]


@pytest.mark.parametrize(
    ("spoil", "sentence"),
    [
        (shutil.rmtree, "there is no folder of certificates"),
        (without("ca.pem"), "ca.pem; copy the certificate of the authority into this folder"),
        (without("base_robot.pem"), "there is no file .*base_robot.pem"),
        (
            without("base_robot.key"),
            "there is no file .*base_robot.key; `freeflyer certificates .* --name base_robot` makes it",
        ),
        (with_text("base_robot.pem", "x"), "base_robot.pem is not a PEM certificate"),
        (with_text("ca.pem", ""), "ca.pem is not a PEM certificate"),
        (with_text("base_robot.key", "x"), "base_robot.key is not a PEM private key"),
        (spoil_key_of_another, "base_robot.key does not belong to certificate .*base_robot.pem"),
        (
            spoil_mode,
            r"base_robot.key is accessible to other users \(mode 0640\); `chmod 600 .*base_robot.key` removes the access of other users",
        ),
        (spoil_authority, "was not signed by the authority of .*ca.pem"),
        (spoil_forged_issuer, "was not signed by the authority of .*ca.pem"),
        (
            spoil_age,
            "base_robot.pem expired on .* UTC; `freeflyer certificates .* --renew base_robot` makes a new certificate",
        ),
        (spoil_youth, "is not valid before .* UTC, but the clock of this machine is at"),
        (spoil_use, r"is not for listening \(its extended key usage lacks serverAuth\)"),
        (
            spoil_host,
            "is for 192.0.2.10, not for 127.0.0.1, so peers would reject the certificate on this host; .* --host 127.0.0.1`",
        ),
        (
            spoil_name,
            "belongs to 'controller', but 'base_robot' is expected, because access is granted by name",
        ),
    ],
)
def test_invalid_files_are_rejected_in_one_sentence_before_a_session_is_opened(
    spoil: Callable[..., object], sentence: str, folder: Path, lab: Lab
) -> None:
    spoil(folder) if spoil is shutil.rmtree else spoil(folder, lab)
    options = lab.options(folder, 0)
    with pytest.raises(DeviceError, match=sentence) as caught:
        open_session([], options.connect, "base", robot_protection(options))
    assert "\n" not in str(caught.value)


def test_a_key_with_a_passphrase_is_rejected(folder: Path) -> None:
    from cryptography.hazmat.primitives.serialization import (
        BestAvailableEncryption,
        Encoding,
        PrivateFormat,
        load_pem_private_key,
    )

    path = folder / "controller.key"
    key = load_pem_private_key(path.read_bytes(), None)
    path.write_bytes(
        key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, BestAvailableEncryption(b"word"))
    )
    with pytest.raises(DeviceError, match="is protected by a passphrase"):
        certificates.check(Identity(folder, "controller"), "base")


# Options of a link in a scenario

FAR = "tcp/192.0.2.10:7447"


@pytest.mark.parametrize(
    ("table", "sentence"),
    [
        ({"connect": [FAR]}, "is not limited to this machine and is not encrypted, so any peer that reaches this endpoint could command the robot; make certificates with "
         "`freeflyer certificates DIR`, then set certificates = 'DIR' and write tls/192.0.2.10:7447 (or set insecure = true)"),
        ({"listen": ["tcp/192.0.2.1:0"]}, "is not limited to this machine and is not encrypted"),
        ({"connect": ["tcp/lab.example:7447"]}, "is not limited to this machine and is not encrypted"),
        ({"connect": ["udp/192.0.2.10:7447"]}, "is not limited to this machine and is not encrypted"),
        ({"connect": ["ws/192.0.2.10:7447"]}, "is not limited to this machine and is not encrypted"),
        ({"connect": ["tcp/[2001:db8::1]:7447"]}, "is not limited to this machine and is not encrypted"),
        ({"listen": ["tcp/0.0.0.0:0"]}, "every interface"),
        ({"listen": ["tcp/[::]:0"]}, "every interface"),
        ({"listen": ["tcp/0.0.0.0:0"], "insecure": True}, "every interface of this machine, which requires certificates"),
        ({"connect": ["tls/127.0.0.1:7447"]}, "is encrypted, but no certificates are named"),
        ({"connect": ["quic/192.0.2.10:7447"], "insecure": True}, "is encrypted, but no certificates are named"),
        ({"connect": ["tcp/127.0.0.1:7447"], "certificates": "c"}, "is not encrypted, but the device has certificates; tls/127.0.0.1:7447"),
        ({"connect": ["tls/x:1"], "listen": ["tcp/127.0.0.1:0"], "certificates": "c"}, "is not encrypted, but the device has"),
        ({"connect": ["tls/x:1#verify_name_on_connect=false"], "certificates": "c"}, "has TLS settings that override the settings of the device"),
        ({"connect": ["tls/x:1"], "certificates": "c", "insecure": True}, "exclude each other"),
        ({"connect": ["tls/x:1"], "certificates": "c", "controller": "a*"}, "controller is 'a*'; the name of a certificate is expected"),
        ({"connect": ["tls/x:1"], "certificates": "c", "commanders": ["x", 3]}, "commanders is 3; the name of a certificate"),
        ({"connect": ["tls/x:1"], "certificates": "c", "commanders": []}, "commanders is empty"),
        ({"connect": ["tls/x:1"], "certificates": "c", "robot": "controller"}, "is both robot and commander"),
        ({"connect": ["tls/192.0.2.10"], "certificates": "c"}, "is incomplete; PROTOCOL/HOST:PORT is expected"),
        ({"connect": ["tcp/[::1]"]}, "is incomplete"),
        ({"connect": ["tcp/:7447"]}, "is incomplete"),
        ({"insecure": "yes"}, "insecure is 'yes'; true or false is expected"),
        ({"certificates": 3}, "certificates is 3; a text is expected"),
        ({"certificate": "c"}, "did you mean 'certificates'"),
    ],
)  # fmt: skip
def test_an_unprotected_link_is_rejected(table: dict[str, object], sentence: str) -> None:
    with pytest.raises(DeviceError) as caught:
        link_options.options_from("base", table, Path("/scenario"))
    assert sentence in str(caught.value)


@pytest.mark.parametrize(
    "table",
    [
        {},
        {
            "connect": [
                "tcp/127.1.2.3:7447",
                "tcp/[::1]:7447",
                "tcp/localhost:7447",
                "unixsock-stream//tmp/x",
            ]
        },
        {"connect": [FAR], "insecure": True},
        {"connect": ["tls/192.0.2.10:7447"], "certificates": "c"},
        {"connect": ["tls/0.0.0.0:7447"], "certificates": "c"},
    ],
)
def test_a_local_or_protected_or_explicitly_insecure_link_is_accepted(
    table: dict[str, object],
) -> None:
    options = link_options.options_from("base", table, Path("/scenario"))
    assert options.certificates == (Path("/scenario/c") if "certificates" in table else None)
    assert (options.robot, list(options.commanders)) == ("base", ["controller"])
    assert options.listen[0].startswith("tls/" if "certificates" in table else "tcp/")


@given(
    address=st.ip_addresses(),
    protocol=st.sampled_from(["tcp", "udp", "ws", "anything"]),
    port=st.integers(0, 65535),
)
def test_no_address_beyond_loopback_is_accepted_without_certificates(
    address: ipaddress.IPv4Address | ipaddress.IPv6Address, protocol: str, port: int
) -> None:
    inner = getattr(address, "ipv4_mapped", None) or address
    assume(not inner.is_loopback)
    host = f"[{address}]" if address.version == 6 else str(address)
    for key in ("connect", "listen"):
        with pytest.raises(DeviceError):
            link_options.options_from("base", {key: [f"{protocol}/{host}:{port}"]}, Path())


def test_notices_report_the_protection_and_warn_before_a_certificate_expires(
    lab: Lab, tmp_path: Path
) -> None:
    lab.authority.issue(Identity(tmp_path, "controller"), days=5.5, hosts=HOSTS, may_listen=True)

    def printed(text: str, *, as_robot: bool) -> list[str]:
        path = tmp_path / "own.toml"
        path.write_text('extends = "facility"\n[devices.base_robot]\n' + text)
        return list(notices(scenario.load(str(path), []), as_robot=as_robot))

    assert printed("", as_robot=False) == []
    first, second = printed('connect = ["tls/192.0.2.10:1"]\ncertificates = "."', as_robot=False)
    assert first.startswith("base_robot: TLS with certificate 'controller', valid until 20")
    assert (
        "WARNING: certificate 'controller' expires in 5 days, and all links with this certificate end at that time; `freeflyer certificates"
        in second
    )
    everywhere = printed(f'connect = ["tls/0.0.0.0:1"]\ncertificates = "{lab.good}"', as_robot=True)
    assert everywhere[0] == "base_robot: tls/0.0.0.0:1 listens on every interface of this machine"
    far = printed('connect = ["tcp/192.0.2.10:1"]\ninsecure = true', as_robot=False)
    assert far == [
        "base_robot: WARNING: tcp/192.0.2.10:1 is not encrypted, so any peer that reaches this endpoint can command the robot (insecure = true)"
    ]
