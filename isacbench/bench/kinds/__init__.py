"""The kinds of suites, a file each: what is planned, measured, summarised, tabulated and drawn."""
