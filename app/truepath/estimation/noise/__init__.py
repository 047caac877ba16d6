"""How large the errors of observations are, and how long they last."""
