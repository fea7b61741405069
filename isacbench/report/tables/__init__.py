"""Tables of a run."""

__all__ = ["link_tables", "pareto", "run_tables", "stage_tables", "study_tables", "tables_by_kind"]
