"""`rig import`: convert a table of foreign measurements, with a mapping of its columns, to an archive."""

from rig.importing.archive_builder import ImportResult, import_table

__all__ = ["ImportResult", "import_table"]
