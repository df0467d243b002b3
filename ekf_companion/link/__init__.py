"""Links by their URL, serial, UDP or TCP, with one interface, reopened whenever they fail.

A link runs in the caller's task group and ends when that task is cancelled::

    link = Link(parse_url("udpin:0.0.0.0:14540"))
    async with asyncio.TaskGroup() as group:
        group.create_task(link.run())
        data, now_ns, sender = await link.receive()

Data is stamped when it is read, and waits in a bounded queue or, to save a turn of the loop, is
passed to ``on_read``. A message that cannot be sent now is dropped (UDP, or no link), or waits for
a short time (serial and TCP). Everything dropped is counted.

``address`` reads URLs, ``port`` has the open descriptors, ``backlog`` the messages that wait for
room, ``peers`` the senders of datagrams that are accepted, ``link`` keeps it all open.
"""
