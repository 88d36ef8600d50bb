"""The application: vehicles, sensors, guidance, laws, missions and claims of underwater and surface craft."""
