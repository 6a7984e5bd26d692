"""Makes the folder of a new robot from EDS files: bus.yml, description, controllers."""
