"""The objective, its noise models and its minimum; predictions of runs that were left out."""
