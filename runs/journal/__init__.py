"""The journal of a running experiment: append-only, readable after any crash."""
