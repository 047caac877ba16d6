"""The truth machine: joints with error motions, composed exactly."""
