"""How far two results, or a result and a direct measurement, differ."""
