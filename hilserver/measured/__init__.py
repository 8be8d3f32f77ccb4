"""External data: foreign logs, tables and bags, as signals in our units on one clock."""
