"""Requests to jobs: arming, the dispatcher, deletion, what happens after a restart."""
