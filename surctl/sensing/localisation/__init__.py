"""Where the robot and the moving obstacles are, by what the base station tells, late or not at all."""
