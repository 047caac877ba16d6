"""Air and material while it was measured, and what the air does to light."""
