"""The page of the viewer: one HTML file that needs no network and no other file."""

from __future__ import annotations

import base64
import hashlib
import html
import json
from collections.abc import Mapping, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

from freeflyer.foundation.errors import CosimError

BUNDLE = Path(__file__).parent / "page"
FORMAT = 1


def page(title: str, runs: Sequence[Mapping[str, Any]], notes: Sequence[str] = ()) -> str:
    """Return the page for one or two runs, each a result of `content.content`."""
    try:
        script = (BUNDLE / "viewer.js").read_text(encoding="utf-8")
        style = (BUNDLE / "viewer.css").read_text(encoding="utf-8")
    except OSError as error:
        raise CosimError(f"the viewer {BUNDLE} cannot be read: {error.strerror}. Reinstall the package") from error  # fmt: skip
    data = json.dumps(
        {
            "format": FORMAT,
            "title": title,
            "created_by": f"freeflyer-cosim {version('freeflyer-cosim')}",
            "notes": list(notes),
            "runs": list(runs),
        },
        separators=(",", ":"),
        allow_nan=False,
    )
    # In a script element, only "<" can end the element or open a comment.
    data = data.replace("<", "\\u003c").replace("\u2028", "\\u2028").replace("\u2029", "\\u2029")
    policy = f"default-src 'none'; script-src '{_digest(script)}'; style-src '{_digest(style)}'; img-src data: blob:"
    return (
        '<!doctype html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        f'<meta http-equiv="Content-Security-Policy" content="{policy}">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{html.escape(title)}</title>\n<style>{style}</style>\n</head>\n<body>\n"
        "<noscript>This page shows a run. It needs JavaScript, which the browser has disabled.</noscript>\n"
        f'<script type="application/json" id="data">{data}</script>\n<script>{script}</script>\n</body>\n</html>\n'
    )


def _digest(text: str) -> str:
    """Return the source expression of a content security policy for an inline element."""
    return "sha256-" + base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()
