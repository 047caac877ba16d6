"""Commands that compute from files: analyse, discover, plan, verify, trend."""
