"""Worker processes: guarded cells on this machine and on others."""

__all__ = ["cluster", "guarded_cells", "guarded_process"]
