"""The HTML file: template, script and style in one, with compressed data and no way out of the page."""

from __future__ import annotations

import base64
import hashlib
import html
import json
import re
import zlib
from functools import cache
from importlib.resources import files
from typing import TYPE_CHECKING, Any

import numpy as np

from isacbench.bench.store.run_folder import replacing

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import ArrayLike

SCRIPTS = (
    *("data", "elements", "figures", "tables", "clouds", "filters"),
    *("overview", "curves", "images", "maps", "scenes", "time", "studies", "comparison", "all_rows"),
    *("views", "start"),
)
"""Parts of the page's script, in the order in which they are joined."""

DIGITS = 6
"""Significant digits of numbers in a page."""

GZIP = 16 + zlib.MAX_WBITS
"""Window of zlib that stands for the format gzip, which browsers read."""


def write_page(path: Path, title: str, content: dict[str, Any], clouds: bytes) -> None:
    """Write a page, in place of an older one.

    The page loads nothing, and runs two scripts: its own and that of plotly, whose digests its
    Content-Security-Policy names.

    Parameters
    ----------
    content : dict
        In terms of JSON, as `isacbench.report.html.page_content.page_content` makes it.
    clouds : bytes
        As `isacbench.report.html.packed_clouds.pack_clouds` makes it.

    Raises
    ------
    InputError
        If the file cannot be written.
    """
    own = "\n".join(_asset(f"{name}.js") for name in SCRIPTS)
    packed_plotly, plotly_digest = _plotly()
    text = json.dumps(content, separators=(",", ":"), allow_nan=False)
    replaced = {
        "policy": f"default-src 'none'; script-src {_digest(own)} {plotly_digest}; "
        "style-src 'unsafe-inline'; img-src data: blob:; base-uri 'none'; form-action 'none'",
        "title": html.escape(title),
        "style": _asset("page.css"),
        "content": _packed(text.encode()),
        "clouds": _packed(clouds),
        "plotly": packed_plotly,
        "script": own,
    }
    page = re.sub(r"\{\{(\w+)\}\}", lambda found: replaced[found[1]], _asset("page.html"))
    with replacing(path, afterwards="") as temporary:
        temporary.write_text(page, encoding="utf-8", newline="\n")


def numbers(values: ArrayLike) -> list[float | None]:
    """Write numbers for JSON, with six significant digits.

    Returns
    -------
    list of float or None
        None for what is not finite.

    Examples
    --------
    >>> numbers([1.23456789, np.nan, 2])
    [1.23457, None, 2.0]
    """
    listed: list[float | int] = np.asarray(values).tolist()
    return [
        number if isinstance(number, int) else _short(number) if np.isfinite(number) else None
        for number in listed
    ]


def _short(number: float) -> float:
    return float(f"{number:.{DIGITS}g}")


@cache
def _asset(name: str) -> str:
    return (files(__package__) / "page" / name).read_text(encoding="utf-8")


@cache
def _plotly() -> tuple[str, str]:
    """Script of plotly, packed, and its digest."""
    script = (files("plotly") / "package_data" / "plotly.min.js").read_text(encoding="utf-8")
    return _packed(script.encode()), _digest(script)


def _digest(script: str) -> str:
    """Digest of a script as a Content-Security-Policy writes it."""
    return f"'sha256-{base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()}'"


def _packed(content: bytes) -> str:
    """Compress bytes with gzip and write them as text."""
    packer = zlib.compressobj(level=6, wbits=GZIP)
    return base64.b64encode(packer.compress(content) + packer.flush()).decode()
