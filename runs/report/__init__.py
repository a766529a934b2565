"""The report of a run or several: figures and one HTML page."""
