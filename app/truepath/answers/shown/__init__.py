"""What all reports share: numbers for people, charts, figures, the frame of a page."""
