"""The archive of a run: a journal turned into NeXus HDF5."""
