"""What a run leaves behind: journal, archive, catalogue, report."""
