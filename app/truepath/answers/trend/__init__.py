"""How errors move from Run to Run, and what that lets one expect."""
