"""What an earlier analysis stated and a later one takes in."""
