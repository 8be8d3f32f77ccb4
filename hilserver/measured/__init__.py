"""Data from outside: logs, tables and bags of others, as signals in our units on one clock."""
