"""What people run: ``jobs`` (one job file), ``batches`` (many of them), ``cli`` (commands and reports)."""
