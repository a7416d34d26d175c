"""What surrounds a run: its loop, its log, signals, locks, failures."""
