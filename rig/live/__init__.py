"""The page in the browser: watch, pause and stop a run, or play an archive. It is a process of its own.

See docs/how-to/watch-in-the-browser.md.
"""
