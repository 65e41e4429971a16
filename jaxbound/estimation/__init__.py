"""Set-membership estimation: data validation, multiple models, unknown inputs."""
