"""What the model still lacks."""
