"""Frequency responses of full and reduced models, and how far they are apart."""
