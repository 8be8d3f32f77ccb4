"""report.html of an experiment, drawn and styled with the parts of the diagnosis's report."""
