"""Job files: read, checked, forecast, run, compared."""
