"""What all families of decks share: options, problems with cures, meanings of element names, includes, ties."""
