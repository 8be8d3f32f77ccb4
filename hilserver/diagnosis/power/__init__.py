"""What a diagnosis would have found in a recording: known effects, put into the user's own log."""
