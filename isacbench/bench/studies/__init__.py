"""Studies: what each kind of suite runs and measures."""
