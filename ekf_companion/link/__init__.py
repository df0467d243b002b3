"""A link by its URL: serial, UDP or TCP, opened again for ever, all of one kind to the caller.

A link runs in the caller's task group and ends when that task is cancelled::

    link = open_link("udpin:0.0.0.0:14540")
    async with asyncio.TaskGroup() as group:
        group.create_task(link.run())
        data, now_ns, sender = await link.receive()

What is read is stamped at once and waits in a bounded queue, or, to save a turn of the loop, is
handed to ``on_read`` and waits in the system's own; what cannot be sent now is dropped
(UDP, or no link) or waits, but not for long (serial and TCP). Everything dropped is counted.

``address`` reads URLs, ``port`` holds the open descriptors, ``backlog`` what they had no room for,
``peers`` says which senders of datagrams are heard, ``link`` keeps it all open.
"""
