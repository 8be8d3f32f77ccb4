"""The page of the scenarios: what happens, what the diagnosis says of it, and a plot of each."""
