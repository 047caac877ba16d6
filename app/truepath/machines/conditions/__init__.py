"""What has to hold before a machine may move."""
