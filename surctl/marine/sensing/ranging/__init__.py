"""Range estimation from raw sonar samples: the filters of the paper, and the robust range tracker."""
