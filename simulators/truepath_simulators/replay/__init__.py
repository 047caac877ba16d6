"""A recorded Run played back as devices."""
