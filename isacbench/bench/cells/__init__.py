"""One cell of a run: an estimate that is timed, scored and recorded."""

__all__ = ["cell", "record"]
