"""The fault campaign: every way in which a run can fail, at random moments, watched from outside."""
