"""`rig import`: measurements from elsewhere, a table and a mapping that explains it, into archives like a run's."""

from rig.importing.archive_builder import Imported, import_table

__all__ = ["Imported", "import_table"]
