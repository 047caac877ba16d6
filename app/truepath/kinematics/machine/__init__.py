"""The machine's chain of axes and its symbols. What moves it off is `effects`."""
