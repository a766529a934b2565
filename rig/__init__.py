"""The running experiment: everything that touches hardware, time or the operator."""
