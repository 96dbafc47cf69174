"""The program in forks of a process that has loaded it: each gets one signal once it waits.

Each line of standard input is a command: its words, folder, the number of the signal, and a file that it
waits to open, or none. It waits once that file is opened, a name server of this machine is asked, or a
connection to a server of this machine is made, whose port stands for {port} in the words. Neither of the two
ever answers. The line of the answer has the exit code (none if the signal did not end the program), whether
it waited, and the words on its standard error.
"""

import json
import os
import select
import signal
import socket
import sys

from vlp16emu.cli.app import main
from vlp16emu.doors import DOORS, door

DNS_PORT = 53
LONGEST_S = 30.0  # longer than any end by a signal, shorter than a look-up of names


def load():
    """Load what the verbs use."""
    for verb in DOORS["verbs"]:
        door(verb, "verbs")
    for module in ("vlp16emu.run.emulator", "vlp16emu.extras.dataset.run", "vlp16emu.extras.bench.outlets"):
        __import__(module)


def run_child(command, opened, errors):
    """Carry out the program, and say when it opens the file."""

    def note(event, arguments):
        if event == "open" and str(arguments[0]) == command["file"]:
            os.write(opened, b".")

    os.chdir(command["folder"])
    if command["file"]:
        sys.addaudithook(note)
    streams = os.open(os.devnull, os.O_RDONLY), os.open(os.devnull, os.O_WRONLY), errors
    for number, stream in enumerate(streams):
        os.dup2(stream, number)
    sys.stdin = os.fdopen(0, closefd=False)  # the others hold the place of what they have read
    sys.stdout = os.fdopen(1, "w", closefd=False)
    sys.stderr = os.fdopen(2, "w", closefd=False)
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.default_int_handler if number == signal.SIGINT else signal.SIG_DFL)
    sys.argv = ["vlp16emu", *command["words"]]
    main()


def carry_out(command, servers):
    """Fork the program, send the signal as it waits, and return how it ended."""
    ours, theirs = os.pipe()
    read, errors = os.pipe()
    child = os.fork()
    if not child:
        code = 1
        try:
            run_child(command, theirs, errors)
        except SystemExit as end:
            code = end.code or 0
        finally:
            sys.stderr.flush()
            os._exit(code)
    os.close(theirs)
    os.close(errors)
    process = os.pidfd_open(child)
    ready, _, _ = select.select([ours, process, *servers], [], [], LONGEST_S)
    waited = any(server in ready for server in servers) or (ours in ready and os.read(ours, 1) == b".")
    if waited:
        signal.pidfd_send_signal(process, command["signal"])
    ended = select.select([process], [], [], LONGEST_S)[0]
    if not ended:
        signal.pidfd_send_signal(process, signal.SIGKILL)
    _, status = os.waitpid(child, 0)
    said = os.fdopen(read, "rb").read().decode()
    os.close(ours)
    os.close(process)
    for server in servers:
        server.setblocking(False)
        try:
            while True:
                if server.type == socket.SOCK_DGRAM:
                    server.recv(1000)
                else:
                    server.accept()[0].close()
        except BlockingIOError:
            server.setblocking(True)
    return {"code": os.waitstatus_to_exitcode(status) if ended else None, "waited": waited, "said": said}


def main_here():
    """Answer commands until the input ends; an argument is the file of a resolver for this machine."""
    silent = socket.create_server(("127.0.0.1", 0))
    servers = [silent]
    if sys.argv[1:]:
        names = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        names.bind(("127.0.0.1", DNS_PORT))
        servers.append(names)
    load()
    for line in sys.stdin:
        command = json.loads(line)
        command["words"] = [word.replace("{port}", str(silent.getsockname()[1])) for word in command["words"]]
        print(json.dumps(carry_out(command, servers)), flush=True)


if __name__ == "__main__":
    main_here()
