"""The live page as one HTML text that loads nothing but its own stream.

The rule of this file: script, style and the plot library are in the page; what changes comes by the stream.
"""

import json
from importlib import resources

from trial.report.page import asset


def html(token: str, nonce: str) -> str:
    """Return the page; `token` goes with its requests, `nonce` marks the scripts that may run."""
    return (_own("live.html")
            .replace("/*STYLE*/", asset("uPlot.min.css") + asset("page.css") + _own("live.css"))
            .replace("<!--LICENSE-->", f"<!-- With uPlot:\n{asset('uPlot.LICENSE')}-->")
            .replace("NONCE", nonce)
            .replace('"TOKEN"', json.dumps(token))
            .replace("/*UPLOT*/", asset("uPlot.iife.min.js"))
            .replace("/*SCRIPT*/", _own("live.js")))


def _own(name: str) -> str:
    return resources.files("bowden.live").joinpath("assets", name).read_text(encoding="utf-8")
