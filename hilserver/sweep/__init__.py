"""One controller against thousands of machines, in virtual time.

`model` is the file; `prepare` turns it, once, into what a worker needs; `draws` defines the machine
with an index; `rig` drives one machine; `batch` is what a worker does; `campaign` hands batches to
workers and survives their death; `journal` keeps finished results; `table` is the result.
"""
