"""Commands that speak to machines and devices."""
