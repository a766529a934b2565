"""Analysis of a study: its runs as a table, the effects of its factors, and its page."""
