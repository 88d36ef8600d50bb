"""From raw samples to a range to act on: the filters of the paper, and the robust tracker."""
