"""The paper's evaluation on our own robot: event tables, statistics, process maps."""
