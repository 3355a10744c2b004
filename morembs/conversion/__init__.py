"""What an importer returns becomes a model."""
