"""CAN bus between processes of one machine, without a kernel driver (`interface = "local"`).

Every bus object listens on a Unix socket (SOCK_SEQPACKET) in the directory of its channel. It also
connects to all other sockets in this directory. No server process is needed. Each packet is one
`struct canfd_frame` (linux/can.h, 72 bytes).

Node: one bus object on a channel. Peer: another node on the same channel.

This interface is for tests. It has these limits:

- There is no bit timing, no arbitration and no acknowledgement.
- If a peer does not read its frames, its socket buffer becomes full. Then further frames to this
  peer are lost. In the same way, a CAN controller loses frames when its receive buffer overflows.
- The frames of one sender arrive in order. The frames of different senders may be reordered.
- The interface needs Linux, because other systems have no SOCK_SEQPACKET for Unix sockets.

Only processes of the same user can connect, because the directory has mode 0700.
"""

from __future__ import annotations

import contextlib
import errno
import fcntl
import os
import re
import select
import socket
import struct
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from can import BusABC, CanInitializationError, CanOperationError, CanProtocol, Message

from freeflyer_adapters.foundation import private_directory

FRAME = struct.Struct("=IBBBB64s")
"""Fields: can_id with the flags of the identifier, length, flags, two reserved bytes, data."""
EXTENDED, REMOTE, ERROR = 0x80000000, 0x40000000, 0x20000000
BIT_RATE_SWITCH, ERROR_STATE, FD_FORMAT = 0x01, 0x02, 0x04
CHANNEL = re.compile(r"[A-Za-z0-9._-]{1,32}")
IGNORED = ("bitrate", "data_bitrate", "timing", "state", "single_handle", "ignore_config")
"""Settings of real interfaces that this interface accepts and ignores."""
MOST_UNWANTED, MOST_PEERS = 64, 16
"""Limits that bound the duration of a receive call.

MOST_UNWANTED: number of frames. At the end of its timeout, the call fails if the filters have
removed this number of frames or more. MOST_PEERS: largest number of new peers that are accepted at
once.
"""
SLICE = 2e-4
"""Duration of a sleep [s], after every MOST_UNWANTED frames that the filters have removed."""
SO_TIMESTAMPNS = 35
TIMESPEC = struct.Struct("=qq")


def directory(channel: str) -> Path:
    """Create the directory for the sockets of a channel, and return its path.

    Only the user can access the directory. Raises CanInitializationError for an invalid channel
    name or an unsafe directory.
    """
    if not CHANNEL.fullmatch(channel) or set(channel) == {"."}:
        raise CanInitializationError(
            f"channel {channel!r} of the local CAN interface: up to 32 letters, digits, '.', '_' and '-' are expected"
        )
    root = (
        Path(os.environ.get("XDG_RUNTIME_DIR") or tempfile.gettempdir())
        / f"freeflyer-can-{os.getuid()}"
    )
    for path in (root, root / channel):
        if refused := private_directory.made(path):
            raise CanInitializationError(refused)
    return root / channel


class LocalBus(BusABC):
    """Node on a local channel."""

    def __init__(
        self,
        channel: str = "freeflyer",
        fd: bool = False,
        receive_own_messages: bool = False,
        can_filters: Any = None,
        **kwargs: object,
    ) -> None:
        """Join a channel. `fd`: whether to enable CAN FD.

        A node without CAN FD neither sends nor receives CAN FD frames. The other arguments have the
        same meaning as for other interfaces of python-can. Raises CanInitializationError for an
        unknown setting, or if the channel cannot be opened.
        """
        # Check the settings and the system.
        unknown = sorted(set(kwargs) - set(IGNORED))
        if unknown:
            raise CanInitializationError(f"the local CAN interface has no setting {unknown[0]!r}")
        if not hasattr(socket, "SOCK_SEQPACKET") or not hasattr(select, "epoll"):
            raise CanInitializationError("the local CAN interface needs Linux")
        # Create the listener. The node has one further socket for each peer.
        self.channel_info = f"local channel {channel!r}"
        self._fd = fd
        self._can_protocol = CanProtocol.CAN_FD if fd else CanProtocol.CAN_20
        self._peers: dict[int, socket.socket] = {}
        self._own: socket.socket | None = None
        self._echo: socket.socket | None = None
        self.dropped = 0
        """Number of frames that were lost because the socket buffer of a peer was full."""
        self._epoll = select.epoll()
        self._listener = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self._path: Path | None = None
        # Join the channel. If this fails, close all sockets.
        try:
            self._join(directory(str(channel)))
            if receive_own_messages:
                self._own, self._echo = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
                self._own.setblocking(False)
                self._add(self._echo)
        except OSError as error:
            self._close()
            raise CanInitializationError(
                f"local CAN channel {channel!r} cannot be opened: {error.strerror or error}"
            ) from error
        except BaseException:
            self._close()
            raise
        super().__init__(channel=channel, can_filters=can_filters, **kwargs)

    # Joining and leaving

    def _join(self, folder: Path) -> None:
        """Listen for connections, then connect to all other nodes.

        The lock prevents two connections between the same two nodes.
        """
        with _locked(folder / "lock"):
            path = folder / f"{os.getpid()}-{id(self):x}-{time.monotonic_ns():x}"
            self._listener.bind(str(path))
            self._path = path
            self._listener.listen(64)
            self._listener.setblocking(False)
            self._epoll.register(self._listener, select.EPOLLIN)
            for other in sorted(folder.iterdir()):
                if other.name != "lock" and other != path:
                    self._connect(other)

    def _connect(self, path: Path) -> None:
        peer = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        peer.setblocking(False)
        try:
            peer.connect(str(path))
        except ConnectionRefusedError:
            peer.close()
            path.unlink(missing_ok=True)  # the process of this socket was killed
        except OSError:
            peer.close()
            raise
        else:
            self._add(peer)

    def _add(self, peer: socket.socket) -> None:
        peer.setblocking(False)
        with contextlib.suppress(OSError):
            peer.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, 1)
        self._peers[peer.fileno()] = peer
        self._epoll.register(peer, select.EPOLLIN)

    def _remove(self, peer: socket.socket) -> None:
        self._peers.pop(peer.fileno(), None)
        with contextlib.suppress(OSError, ValueError):
            self._epoll.unregister(peer)
        peer.close()

    def _accept(self) -> None:
        for _ in range(MOST_PEERS):
            try:
                peer, _ = self._listener.accept()
            except BlockingIOError:
                return
            self._add(peer)

    def _close(self) -> None:
        for peer in list(self._peers.values()):
            self._remove(peer)
        if self._own is not None:
            self._own.close()
        self._listener.close()
        self._epoll.close()
        if self._path is not None:
            self._path.unlink(missing_ok=True)
            self._path = None

    def shutdown(self) -> None:
        """Leave the channel. A second call has no effect."""
        if not self._is_shutdown:
            super().shutdown()
            self._close()

    @property
    def peers(self) -> int:
        """Number of other nodes on the channel."""
        self._check_open()
        self._accept()
        return len(self._peers) - (self._echo is not None)

    def fileno(self) -> int:
        """Return a descriptor that is readable while a frame or a new connection is pending."""
        return self._epoll.fileno()

    def _check_open(self) -> None:
        if self._epoll.closed:
            raise CanOperationError(f"{self.channel_info} is shut down")

    # Frames

    def send(self, msg: Message, timeout: float | None = None) -> None:
        """Send a frame to all other nodes without blocking.

        `dropped` counts the frames that a node could not take. Raises CanOperationError if this
        node cannot send the frame.
        """
        self._check_open()
        packet = self._packed(msg)
        self._accept()
        for peer in list(self._peers.values()):
            try:
                peer.send(packet)
            except BlockingIOError:
                self.dropped += 1
            except OSError as error:
                # `_take` removes a closed peer after the last frames of the peer were read.
                if error.errno not in (
                    errno.EPIPE,
                    errno.ECONNRESET,
                    errno.ENOTCONN,
                    errno.ECONNREFUSED,
                ):
                    raise CanOperationError(f"{self.channel_info}: {error.strerror}") from error
        if self._own is not None:
            with contextlib.suppress(BlockingIOError):
                self._own.send(packet)

    def _recv_internal(self, timeout: float | None) -> tuple[Message | None, bool]:
        self._check_open()
        deadline = None if timeout is None else time.monotonic() + timeout
        unwanted = 0
        while True:
            left = -1.0 if deadline is None else max(0.0, deadline - time.monotonic())
            # Request only one event per poll. The kernel selects the ready peers in turn, so the
            # frames of every peer are read. The descriptor of `fileno` stays readable while frames
            # are pending.
            events = self._epoll.poll(left, 1)
            for descriptor, _ in events:
                if descriptor == self._listener.fileno():
                    self._accept()
                    continue
                message = self._take(self._peers[descriptor])
                # Apply the filters here. If `recv` applied them, `recv` with timeout 0 would return
                # None after a filtered frame.
                if message is not None and self._matches_filters(message):
                    return message, True
                unwanted += message is not None
                if message is not None and unwanted % MOST_UNWANTED == 0 and left:
                    time.sleep(SLICE)  # let other processes run during a flood of frames
            if deadline is not None and unwanted >= MOST_UNWANTED and time.monotonic() >= deadline:
                raise CanOperationError(
                    f"{self.channel_info}: a flood of frames; the filters have rejected {unwanted} frames in one receive call"
                )
            if not events and deadline is not None and time.monotonic() >= deadline:
                return None, True

    def _take(self, peer: socket.socket) -> Message | None:
        try:
            packet, extra, _, _ = peer.recvmsg(FRAME.size + 1, 64)
        except (BlockingIOError, ConnectionResetError):
            # ECONNRESET: the peer has closed its socket with unread frames. The last frames of the
            # peer and the end of file are read later.
            return None
        except OSError:
            packet, extra = b"", []
        if not packet:  # the peer has left the channel, or its process has ended
            self._remove(peer)
            return None
        if len(packet) != FRAME.size:
            return None
        message = self._unpacked(packet, _stamp(extra))
        message.is_rx = peer is not self._echo
        return message if self._fd or not message.is_fd else None

    def _packed(self, msg: Message) -> bytes:
        data = bytes(msg.data)
        if msg.is_fd and not self._fd:
            raise CanOperationError(
                f"{self.channel_info} was opened without fd=True; a CAN FD frame cannot be sent"
            )
        if len(data) > (64 if msg.is_fd else 8):
            raise CanOperationError(
                f"a frame of {len(data)} bytes cannot be sent: at most {64 if msg.is_fd else 8} bytes are possible"
            )
        identifier = msg.arbitration_id
        identifier |= EXTENDED if msg.is_extended_id else 0
        identifier |= REMOTE if msg.is_remote_frame else 0
        identifier |= ERROR if msg.is_error_frame else 0
        flags = FD_FORMAT if msg.is_fd else 0
        flags |= BIT_RATE_SWITCH if msg.bitrate_switch else 0
        flags |= ERROR_STATE if msg.error_state_indicator else 0
        return FRAME.pack(
            identifier, msg.dlc if msg.is_remote_frame else len(data), flags, 0, 0, data
        )

    def _unpacked(self, packet: bytes, stamp: float) -> Message:
        identifier, length, flags, _, _, data = FRAME.unpack(packet)
        extended = bool(identifier & EXTENDED)
        remote = bool(identifier & REMOTE)
        length = min(length, 64)
        return Message(
            timestamp=stamp,
            arbitration_id=identifier & (0x1FFFFFFF if extended else 0x7FF),
            is_extended_id=extended,
            is_remote_frame=remote,
            is_error_frame=bool(identifier & ERROR),
            is_fd=bool(flags & FD_FORMAT),
            bitrate_switch=bool(flags & BIT_RATE_SWITCH),
            error_state_indicator=bool(flags & ERROR_STATE),
            dlc=length,
            data=None if remote else data[:length],
            channel=self.channel_info,
        )

    @staticmethod
    def _detect_available_configs() -> list[Any]:
        """Return the channels that have at least one node."""
        root = (
            Path(os.environ.get("XDG_RUNTIME_DIR") or tempfile.gettempdir())
            / f"freeflyer-can-{os.getuid()}"
        )
        folders = sorted(root.iterdir()) if root.is_dir() else []
        return [
            {"interface": "local", "channel": folder.name}
            for folder in folders
            if len(list(folder.iterdir())) > 1
        ]


def _stamp(extra: list[Any]) -> float:
    """Return the kernel's time stamp of a frame [s, CLOCK_REALTIME].

    If the frame has no time stamp, return the present time.
    """
    for _, _, data in extra:
        if len(data) >= TIMESPEC.size:
            whole, nanoseconds = TIMESPEC.unpack_from(data)
            return float(whole + nanoseconds * 1e-9)
    return time.time()


@contextlib.contextmanager
def _locked(path: Path) -> Iterator[None]:
    descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX)
        yield
    finally:
        os.close(descriptor)
