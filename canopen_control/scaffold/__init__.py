"""Generator of a new robot's folder from EDS files: bus.yml, description and controllers."""
