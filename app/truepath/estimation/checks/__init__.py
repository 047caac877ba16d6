"""What contradicts the model: misfits, steps, disturbances, a wrong chain."""
