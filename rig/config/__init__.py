"""The rig file: its schema, consistency checks, loader and overlays."""
