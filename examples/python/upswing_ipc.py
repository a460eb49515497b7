"""Joins a domain of upswing from Python: the same shared memory, the same rules as the Rust processes.

Needs iceoryx2 in exactly the version of the Rust side: every version has its own layout of shared memory.
"""

import ctypes
import fcntl
import math
import os
import re
import time
from contextlib import contextmanager
from pathlib import Path

import iceoryx2 as iox2
import numpy as np
import upswing_layouts as layouts

KEY = ctypes.c_uint64(0)
EPOCH_DIGITS = 20


class Refused(Exception):
    """A process of upswing said no, or none answered."""


def copy(payload):
    """A copy that the other process cannot change any more."""
    return type(payload).from_buffer_copy(payload)


def text(field):
    """The text of a field of class Text; from another process, so nothing in it is trusted."""
    return bytes(field.bytes[: min(field.len, len(field.bytes))]).decode(errors="replace")


def manoeuvre(name, given=()):
    """A manoeuvre of the system's settings with the values that its target asks for, rad or m; NaN: where the joint is."""
    request = layouts.ManoeuvreRequest(number=len(given))
    request.given[: len(given)] = given
    encoded = name.encode()
    request.name.bytes[: len(encoded)] = encoded
    return request


class Node:
    """A seat in a domain (`--domain NAME`), under a role for logs."""

    def __init__(self, domain, role):
        if not re.fullmatch(r"[a-z0-9_-]{1,%d}" % layouts.MAX_DOMAIN, domain):
            raise ValueError(
                f"domain `{domain}`: expected 1 to {layouts.MAX_DOMAIN} characters of a-z, 0-9, _ and -"
            )
        self.domain = domain
        self.root = f"/dev/shm/upswing.{domain}.iox"
        os.makedirs(self.root, mode=0o700, exist_ok=True)
        if os.stat(self.root).st_uid != os.geteuid():
            raise PermissionError(f"{self.root} belongs to another user")
        # As long as this lock is held nobody removes the domain.
        self._presence = os.open(self.root, os.O_RDONLY)
        fcntl.flock(self._presence, fcntl.LOCK_SH)
        prefix = f"upswing_{domain}_"
        config = iox2.config.default()
        config.global_cfg.root_path = iox2.Path.new(self.root)
        config.global_cfg.prefix = iox2.FileName.new(prefix)
        # upswing cleans up under its own lock, below.
        config.global_cfg.node.cleanup_dead_nodes_on_creation = False
        config.global_cfg.node.cleanup_dead_nodes_on_destruction = False
        config.global_cfg.service.cleanup_dead_nodes_on_open = False
        self.config = config
        with self.creation_lock():
            self._load_global_config(prefix)
            builder = iox2.NodeBuilder.new().name(iox2.NodeName.new(role)).config(config)
            builder = builder.signal_handling_mode(iox2.SignalHandlingMode.Disabled)
            self.iox = builder.create(iox2.ServiceType.Ipc)
            self.clean_up()

    def _load_global_config(self, prefix):
        """Without it iceoryx2 looks for settings in the working directory when it cleans up after a dead process."""
        file = Path(self.root) / "iceoryx2.toml"
        settings = f'[global]\nroot-path = "{self.root}"\nprefix = "{prefix}"\n'
        if not file.exists() or file.read_text(encoding="utf-8") != settings:
            file.write_text(settings, encoding="utf-8")
        iox2.config.setup_global_config_from_file(iox2.FilePath.new(str(file)))
        iox2.set_log_level(iox2.LogLevel.Error)

    @contextmanager
    def creation_lock(self):
        """The lock for whoever creates, lists or cleans up in the domain; upswing removes unfinished files of others."""
        lock = os.open(f"{self.root}/creation.lock", os.O_CREAT | os.O_WRONLY, 0o600)
        try:
            fcntl.flock(lock, fcntl.LOCK_EX)
            yield
        finally:
            os.close(lock)

    def clean_up(self):
        """Removes what dead processes left; only under `creation_lock`."""
        self.iox.blocking_cleanup_dead_nodes(iox2.Duration.from_millis(200))

    def _service(self, name):
        return self.iox.service_builder(iox2.ServiceName.new(name))

    def _wait(self, what, attempt, patience):
        end = time.monotonic() + patience
        while True:
            with self.creation_lock():
                self.clean_up()
                if (found := attempt()) is not None:
                    return found
            if time.monotonic() > end:
                raise Refused(f"no {what} in domain `{self.domain}`: is it running?")
            time.sleep(0.02)

    def subscribe(self, topic, patience=30.0):
        """A subscriber of `layouts.TELEMETRY`, once there is a publisher."""
        name, payload, buffer = topic
        return self._subscribe(name, lambda service: service.publish_subscribe(payload), buffer, patience)

    def subscribe_plans(self, patience=30.0):
        """The plans that the planner publishes, once there is one."""
        name, header, buffer = layouts.PLAN
        plans = lambda service: service.publish_subscribe(iox2.Slice[ctypes.c_double]).user_header(header)
        return Plans(self._subscribe(name, plans, buffer, patience))

    def _subscribe(self, name, pattern, buffer, patience):
        def attempt():
            try:
                service = pattern(self._service(name)).open()
                return service.subscriber_builder().buffer_size(buffer).create()
            except iox2.PublishSubscribeOpenError:
                return None

        return self._wait(f"publisher of `{name}`", attempt, patience)

    def client(self, service, patience=30.0):
        """Asks `layouts.CONTROL`, `layouts.PLANNER` or `layouts.PLANT`, once there is a server."""
        name, request, response = service

        def attempt():
            try:
                opened = self._service(name).request_response(request, response).open()
            except iox2.RequestResponseOpenError:
                return None
            served = opened.dynamic_config.number_of_servers > 0
            return Client(name, opened.client_builder().create()) if served else None

        return self._wait(f"server of `{name}`", attempt, patience)

    def writer(self, channel, payload):
        """A blackboard of this start of the writer, `channel/epoch`."""
        with self.creation_lock():
            name = f"{channel}/{time.monotonic_ns():0{EPOCH_DIGITS}}"
            builder = self._service(name).blackboard_creator(ctypes.c_uint64)
            builder = builder.max_readers(layouts.MAX_READERS).max_nodes(layouts.MAX_NODES)
            service = builder.add(KEY, payload()).create()
            return Writer(service, service.writer_builder().create(), payload)

    def newest_reader(self, channel, payload, than=None):
        """A reader of the newest blackboard of a channel whose writer lives; None if that is `than`, or there is none."""
        with self.creation_lock():
            self.clean_up()
            listed = (service.name().to_string() for service in iox2.Service.list(self.config, iox2.ServiceType.Ipc))
            found = sorted((n for n in listed if re.fullmatch(rf"{channel}/\d{{{EPOCH_DIGITS}}}", n)), reverse=True)
            for name in found:
                if than is not None and name <= than.name:
                    return None
                try:
                    service = self._service(name).blackboard_opener(ctypes.c_uint64).open()
                except iox2.BlackboardOpenError:
                    continue
                if service.dynamic_config.number_of_writers > 0:
                    return Reader(name, service, service.reader_builder().create(), payload)
        return None

    def lives(self, reader):
        """Whether the process that writes a blackboard has not ended."""
        with self.creation_lock():
            self.clean_up()
            return reader.written()


class Plans:
    """A subscriber of plans."""

    def __init__(self, port):
        self.port = port

    def take(self):
        """The oldest plan that was not taken yet, or None."""
        if (sample := self.port.receive()) is None:
            return None
        header = copy(sample.user_header().contents)
        try:
            # Not `payload().len()`: in iceoryx2 0.10 that is the number of bytes (issue 1533).
            return Plan(header, sample.payload_ptr, sample.header.number_of_elements)
        finally:
            sample.delete()


class Plan:
    """A plan in arrays: x, f: knots x 2n; u: knots x n_A; k: knots x n_A x 2n; k_final: n_A x 2n. Joints from base to tip."""

    def __init__(self, header, address, length):
        n, actuated, knots = header.joints, header.actuated, header.intervals + 1
        shapes = [(knots, 2 * n), (knots, actuated), (knots, 2 * n), (knots, actuated, 2 * n), (actuated, 2 * n)]
        lengths = [math.prod(shape) for shape in shapes]
        if not 0 < actuated < n <= layouts.MOST_JOINTS or length != sum(lengths):
            raise ValueError(f"damaged plan: {length} numbers for n = {n}, n_A = {actuated}, N = {header.intervals}")
        values = np.frombuffer(ctypes.string_at(address, length * ctypes.sizeof(ctypes.c_double)))
        parts = np.split(values, np.cumsum(lengths)[:-1])
        self.header = header
        self.x, self.u, self.f, self.k, self.k_final = (part.reshape(shape) for part, shape in zip(parts, shapes))


class Client:
    """Sends requests to one server."""

    def __init__(self, name, port):
        self.name, self.port = name, port

    def call(self, request, patience=30.0):
        """The answer; the caller checks what is in it."""
        pending = self.port.send_copy(request)
        end = time.monotonic() + patience
        while (answer := pending.receive()) is None:
            if time.monotonic() > end:
                raise Refused(f"`{self.name}` did not answer for {patience:.0f} s")
            time.sleep(0.0005)
        return copy(answer.payload().contents)


class Writer:
    """The writing end of a blackboard."""

    def __init__(self, service, port, payload):
        self._service, self._port = service, port
        self._entry = port.entry(KEY, payload)

    def write(self, value):
        self._entry.update_with_copy(value)


class Reader:
    """The reading end of a blackboard."""

    def __init__(self, name, service, port, payload):
        self.name = name
        self._service, self._port, self._payload = service, port, payload
        self._entry = port.entry(KEY, payload)
        self._seen = None

    def written(self):
        """Whether there is a writer; one that died counts until somebody cleans up."""
        return self._service.dynamic_config.number_of_writers > 0

    def take(self):
        """The value, if it was written since the last call; else None."""
        if self._seen is not None and self._entry.is_up_to_date(self._seen):
            return None
        self._seen = self._entry.get()
        return self._seen.decode_as(self._payload)
