"""What there is to warn of in models and in delivered bodies."""
