"""What every layer may use: errors, files, users' imports, optional dependencies, parallel work."""
