"""What both executors, real time and virtual time, are given and give back."""
