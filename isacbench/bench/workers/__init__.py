"""Worker processes: guarded cells on this machine and on others."""

__all__ = ["cell", "cluster", "guarded_process", "worker"]
