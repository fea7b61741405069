"""Stress runs: cases chosen, gone through in guarded processes, and tabulated."""

__all__ = ["examining", "families", "random_search", "stress_runs", "stress_table"]
