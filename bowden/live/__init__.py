"""The live page: a trial that runs, a running bus, or a recorded trial, in a browser.

It promises that no visitor delays a control cycle, that a viewer sends nothing on a bus, and that old values are
grey. Start reading in `state`, the content of a page; `feeds` fills it, `web` serves it, `page_process` serves it for
a running trial from a process of its own.
"""
