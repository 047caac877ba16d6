"""HTTP: the interface (`api`) and the operator's page (`page`)."""
