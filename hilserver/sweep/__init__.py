"""One controller against thousands of machines, in virtual time.

`model` is the file; `prepare` makes of it what a worker needs, once; `draws` says what the machine
with an index is; `rig` drives one machine; `batch` is what a worker does; `campaign` hands batches
to workers and outlives them; `journal` keeps what is finished; `table` is the result.
"""
