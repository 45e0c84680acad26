"""What instruments give: measurement models, their residuals, and when they measure."""
