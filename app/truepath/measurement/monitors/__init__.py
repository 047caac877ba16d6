"""What is looked at while a machine moves: stream, controller, disk, sensors."""
