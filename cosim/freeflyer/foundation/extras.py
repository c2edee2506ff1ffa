"""Extras of the distribution: groups of optional dependencies.

`pip install 'freeflyer-cosim[hil]'` installs the extra `hil`. Without an extra, its modules are
missing. Code that needs a missing module raises `MissingExtra`.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from importlib.util import find_spec

from freeflyer.foundation.errors import CosimError

DISTRIBUTION = "freeflyer-cosim"
EXTRAS: Mapping[str, tuple[str, ...]] = {
    "analysis": ("xarray",),
    "export": ("casadi", "coal", "pinocchio", "ziglang"),
    "hil": ("can", "canopen", "cantools", "cryptography", "e2e", "lz4", "mcap", "zenoh", "zstandard"),
    "sweep": ("dask", "distributed"),
}  # fmt: skip
"""Import names of the packages that each extra installs. `pyproject.toml` has the versions."""
_EXTRA_OF = {package: extra for extra, packages in EXTRAS.items() for package in packages}


class MissingExtra(CosimError, ImportError):
    """An extra is not installed. The message contains the command that installs it.

    The attribute `name` is the import name of a missing package.
    """


@contextmanager
def needed_by(subject: str) -> Iterator[None]:
    """Raise MissingExtra if a package of an extra is not found inside this context.

    `subject` is the subject of the message: the command, component or name that needs the package.
    """
    try:
        yield
    except ModuleNotFoundError as error:
        # If an installed package lacks one of its modules, `name` contains a dot. This error is not
        # converted.
        if error.name not in _EXTRA_OF:
            raise
        raise _missing(subject, error.name) from error


def require(subject: str, packages: Iterable[str]) -> None:
    """Raise MissingExtra if one of these packages of the extras is not installed.

    Use this function before work that would be lost, or if the package is not imported. `subject`
    is the subject of the message.
    """
    for package in packages:
        if find_spec(package) is None:
            raise _missing(subject, package)


def _missing(subject: str, package: str) -> MissingExtra:
    extra = _EXTRA_OF[package]
    return MissingExtra(
        f"{subject} needs the extra {extra}: pip install '{DISTRIBUTION}[{extra}]'", name=package
    )
