"""Where to put the tracker."""
