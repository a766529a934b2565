"""The page in the browser: watch, pause and stop a run, or play an archive. A process of its own; see docs/live.md."""
