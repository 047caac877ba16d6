"""Job state, workflow, workers, store."""
