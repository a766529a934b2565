"""One run from request to archive, and what is computed from runs again."""
