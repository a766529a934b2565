"""Publication of runs: a research object crate with metadata, checksums, and a description of the fields."""
