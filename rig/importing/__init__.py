"""`rig import`: convert a table of foreign measurements, with a mapping of its columns, to an archive."""

from rig.importing.archive_builder import Imported, import_table

__all__ = ["Imported", "import_table"]
