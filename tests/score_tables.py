"""Columns of the metrics of clouds, counts included, by metric and name."""

from isacbench.metrics.paper import Paper, Repository
from isacbench.plugins.scoring import COUNTS

METRICS = {
    metric.name: {column.name: column for column in (*COUNTS, *metric.columns)}
    for metric in (Paper, Repository)
}
