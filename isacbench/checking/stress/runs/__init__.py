"""Stress runs: cases chosen, gone through in guarded processes, and tabulated."""
