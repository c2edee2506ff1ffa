"""`run_loop` and `read_recording` in a script."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

import freeflyer as ff
from freeflyer_adapters import read_recording, run_loop


def test_the_result_of_a_loop_is_shown_as_the_table_of_its_errors(tmp_path: Path) -> None:
    shown: list[str] = []
    done = run_loop(
        "facility", {"stop_s": 0.2}, virtual=True, directory=tmp_path, show=shown.append
    )
    assert repr(done).splitlines()[0] == done.scenario.title
    assert repr(done).endswith("completed")
    assert len(repr(done).splitlines()) < 20
    assert len(read_recording(tmp_path)) == 200


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        ({"simulated": True, "virtual": True}, "both simulated and virtual"),
        ({"virtual": True, "can_format": "xyz"}, "can_format is 'xyz'; blf or asc is expected"),
        ({"virtual": True, "log_to": "nowhere"}, "there is no log 'nowhere'"),
    ],
)
def test_a_wrong_argument_of_a_loop_is_found_before_anything_moves(
    tmp_path: Path, arguments: dict[str, Any], expected: str
) -> None:
    with pytest.raises(ff.CosimError, match=expected):
        run_loop("facility", directory=tmp_path, **arguments)
    assert not list(tmp_path.iterdir())


def test_a_recording_of_another_type_is_one_sentence() -> None:
    with pytest.raises(ff.RecordError, match="the recording is None of type NoneType"):
        read_recording(None)  # type: ignore[arg-type]
