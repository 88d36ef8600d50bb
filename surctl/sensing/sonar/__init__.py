"""The sonars: where they look, what they hear and what may be wrong with them, in numbers and in symbols."""
