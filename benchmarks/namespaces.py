"""A slow network on one machine: nodes that are network namespaces (root, Linux, Open MPI).

    .venv/bin/python benchmarks/namespaces.py [--rate 1gbit] [--each 1] RANKS COMMAND...

runs `mpirun -n RANKS COMMAND...` with so many ranks in each namespace, over TCP between namespaces and shared memory
within; a namespace's outgoing link is limited by `tc` to the rate. Namespaces and bridge are removed in the end. More
ranks than cores yield while they wait.
"""

import argparse
import os
import subprocess
import sys
import tempfile
from pathlib import Path

NAME, SUBNET = "rvmnet", "10.77.0"


def ip(*words, check=True):
    subprocess.run(["ip", *words], check=check, stderr=None if check else subprocess.DEVNULL)


def add(number, rate):
    """Namespace, link and address of one node."""
    space = f"{NAME}{number}"
    ip("netns", "add", space)
    ip("link", "add", f"{space}h", "type", "veth", "peer", "name", f"{space}n")
    ip("link", "set", f"{space}h", "master", NAME, "up")
    ip("link", "set", f"{space}n", "netns", space)
    ip("-n", space, "addr", "add", f"{SUBNET}.{number + 1}/24", "dev", f"{space}n")
    ip("-n", space, "link", "set", "lo", "up")
    ip("-n", space, "link", "set", f"{space}n", "up")
    limit = ["root", "tbf", "rate", rate, "burst", "64kb", "latency", "50ms"]
    subprocess.run(["ip", "netns", "exec", space, "tc", "qdisc", "add", "dev", f"{space}n", *limit], check=True)


def run(ranks, each, command):
    hosts = ",".join(f"{SUBNET}.{number + 1}:{each}" for number in range(ranks // each))
    with tempfile.NamedTemporaryFile("w", suffix=".sh", delete=False) as agent:
        # a host name of its own, by which Open MPI tells nodes
        enter = f'exec ip netns exec {NAME}$n unshare --uts sh -c "hostname {NAME}$n; $*"'
        agent.write(f"#!/bin/sh\nn=$((${{1##*.}} - 1)); shift\n{enter}\n")
    Path(agent.name).chmod(0o700)
    parameters = {
        "plm_rsh_agent": agent.name,
        "btl": "tcp,self" if each == 1 else "tcp,self,vader",
        "btl_tcp_if_include": f"{SUBNET}.0/24",
        "oob_tcp_if_include": f"{SUBNET}.0/24",
        "plm_rsh_no_tree_spawn": "1",  # agents of agents would have to enter namespaces from within one
        "mpi_yield_when_idle": "1",
    }
    words = [word for name, value in parameters.items() for word in ("--mca", name, value)]
    start = ["ip", "netns", "exec", f"{NAME}0", "mpirun", "--host", hosts, "-n", str(ranks), "--bind-to", "none"]
    try:
        return subprocess.run([*start, *words, *command], env=os.environ | {"OMP_NUM_THREADS": "1"}).returncode
    finally:
        Path(agent.name).unlink()


def main():
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("ranks", type=int)
    parser.add_argument("--rate", default="1gbit")
    parser.add_argument("--each", type=int, default=1, help="ranks of a namespace")
    parser.add_argument("command", nargs=argparse.REMAINDER)
    arguments = parser.parse_args()
    nodes, left = divmod(arguments.ranks, arguments.each)
    if left:
        parser.error(f"{arguments.ranks} ranks are no whole nodes of {arguments.each}")
    try:
        ip("link", "add", NAME, "type", "bridge")
        ip("link", "set", NAME, "up")
        for number in range(nodes):
            add(number, arguments.rate)
        return run(arguments.ranks, arguments.each, arguments.command)
    finally:
        for number in range(nodes):
            ip("netns", "delete", f"{NAME}{number}", check=False)
        ip("link", "delete", NAME, check=False)


if __name__ == "__main__":
    sys.exit(main())
