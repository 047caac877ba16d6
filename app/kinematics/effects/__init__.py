"""What moves the measured point off its nominal, one physical cause a file."""
