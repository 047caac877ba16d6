"""One job while it runs: state, measurement, live estimate, resumption."""
