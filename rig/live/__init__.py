"""The live page: watch, pause and stop a run in the browser. It runs in its own process.

See docs/how-to/watch-in-the-browser.md.
"""
