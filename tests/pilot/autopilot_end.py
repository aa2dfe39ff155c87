"""An autopilot's end that speaks real MAVLink over UDP, with a multirotor's dynamics behind it.

The airframe is a point mass that tilts to accelerate: its attitude follows what is asked of it with a lag of the first
order, tilt and thrust are bounded, drag is linear. Modes, commands, parameters and the fence are answered as PX4 does,
as far as MAVSDK asks. Time may run faster than the clock on the wall.
"""

import math
import os
import threading
import time

import numpy as np

os.environ["MAVLINK20"] = "1"
from pymavlink import mavutil
from pymavlink.dialects.v20 import common as mavlink

GRAVITY, TILT_LAG, MOST_TILT, DRAG, CLIMB = 9.81, 0.15, math.radians(35.0), 0.25, 3.0
STEP = 0.02
HOLD, OFFBOARD, TAKEOFF, LAND, RETURN = (4, 3), (6, 0), (4, 2), (4, 6), (4, 5)
METRES_PER_DEGREE = 111_195.0


class Multirotor:
    """x east, y north, z up [m]; flies to where it is told."""

    def __init__(self):
        self.position, self.velocity, self.tilt = np.zeros(3), np.zeros(3), np.zeros(2)

    def step(self, target, speed):
        """One step towards a target."""
        if self.position[2] <= 0.0 and target[2] <= 0.0:
            self.velocity[:] = self.tilt[:] = 0.0
            self.position[2] = 0.0
            return
        wanted = 0.8 * (target - self.position)
        flat = math.hypot(*wanted[:2])
        if flat > speed:
            wanted[:2] *= speed / flat
        wanted[2] = np.clip(wanted[2], -CLIMB, CLIMB)
        push = 2.0 * (wanted[:2] - self.velocity[:2]) + DRAG * wanted[:2]
        lean = np.arctan(push / GRAVITY)
        steepest = max(MOST_TILT, np.abs(lean).max())
        self.tilt += (lean * MOST_TILT / steepest - self.tilt) * STEP / TILT_LAG
        lift = np.clip(3.0 * (wanted[2] - self.velocity[2]), -5.0, 5.0)
        acceleration = np.array([*(GRAVITY * np.tan(self.tilt)), lift]) - DRAG * np.array([*self.velocity[:2], 0.0])
        self.velocity += acceleration * STEP
        self.position += self.velocity * STEP
        if self.position[2] < 0.0:
            self.position[2] = 0.0
            self.velocity[2] = 0.0


class AutopilotEnd:
    """A vehicle on the line; entered, it flies.

    Attributes:
        path: where it has been, [m] from its home.
        modes: in which it has flown, in order.
        fence: corners of the inclusion polygon that was uploaded [degrees].
        refuse: commands that it denies.
        mute: it says and hears nothing while this is set.
    """

    def __init__(self, port, home=(44.4949, 11.3426), pace=4.0, refuse=()):
        self.port, self.home, self.pace, self.refuse = port, home, pace, set(refuse)
        self.airframe = Multirotor()
        self.armed, self.mode, self.modes = False, HOLD, []
        self.target, self.speed = np.zeros(3), 5.0
        self.setpoint_at = 0.0
        self.parameters = {"MIS_TAKEOFF_ALT": 2.5}
        self.path, self.fence = [], []
        self.mute = threading.Event()
        self._expected = 0
        self._ended = threading.Event()
        self._link = mavutil.mavlink_connection(f"udpout:127.0.0.1:{port}", source_system=1, source_component=1)

    def __enter__(self):
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()
        return self

    def __exit__(self, *_):
        self._ended.set()
        self._thread.join()
        self._link.close()

    def _run(self):
        now, beat, told = 0.0, 0.0, 0.0
        begin = time.monotonic()
        while not self._ended.is_set():
            while (message := self._link.recv_match(blocking=False)) is not None:
                if not self.mute.is_set():
                    self._hear(message, now)
            self._steer(now)
            self.airframe.step(self.target, self.speed)
            self.path.append(self.airframe.position.copy())
            now += STEP
            if not self.mute.is_set():
                if now - told >= 0.2:
                    told = now
                    self._tell(now)
                if now - beat >= 2.0:
                    beat = now
                    self._beat()
            time.sleep(max(0.0, begin + now / self.pace - time.monotonic()))

    def _steer(self, now):
        if self.mode == OFFBOARD and now - self.setpoint_at > 1.0 * self.pace:
            self._enter(RETURN)  # as PX4 does where setpoints stop coming
        if self.mode == RETURN:
            self.target[:2] = 0.0
            if np.hypot(*self.airframe.position[:2]) < 1.0:
                self._enter(LAND)
        if self.mode == LAND:
            self.target = np.array([*self.target[:2], -1.0])
            if self.airframe.position[2] <= 0.05:
                self.armed = False
                self._enter(HOLD)
                self.airframe.position[2] = 0.0
        if not self.armed:
            self.target = np.array([*self.airframe.position[:2], 0.0])

    def _enter(self, mode):
        if mode != self.mode:
            self.mode = mode
            self.modes.append(mode)

    def _beat(self):
        base = mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED | (mavlink.MAV_MODE_FLAG_SAFETY_ARMED if self.armed else 0)
        self._link.mav.heartbeat_send(
            mavlink.MAV_TYPE_QUADROTOR,
            mavlink.MAV_AUTOPILOT_PX4,
            base,
            self.mode[0] << 16 | self.mode[1] << 24,
            mavlink.MAV_STATE_ACTIVE,
        )

    def _tell(self, now):
        x, y, z = self.airframe.position
        east, north, up = self.airframe.velocity
        latitude = self.home[0] + y / METRES_PER_DEGREE
        longitude = self.home[1] + x / (METRES_PER_DEGREE * math.cos(math.radians(self.home[0])))
        place = (round(latitude * 1e7), round(longitude * 1e7))
        height = round(1000 * (55 + z))
        speeds = (round(100 * north), round(100 * east), round(-100 * up))
        send, clock = self._link.mav, round(1000 * now)
        send.global_position_int_send(clock, *place, height, round(1000 * z), *speeds, 0)
        send.gps_raw_int_send(1000 * clock, 3, *place, height, 100, 100, 0, 0, 12)
        home = (round(self.home[0] * 1e7), round(self.home[1] * 1e7), 55_000)
        send.home_position_send(*home, 0, 0, 0, [1, 0, 0, 0], 0, 0, 0)
        send.sys_status_send(0, 0, 0, 0, 15_000, 500, max(0, 90 - round(now / 60)), 0, 0, 0, 0, 0, 0)
        cells = [4000] * 4 + [65535] * 6
        send.battery_status_send(0, 0, 0, 2000, cells, 500, 0, -1, max(0, 90 - round(now / 60)))
        landed = mavlink.MAV_LANDED_STATE_IN_AIR if z > 0.1 else mavlink.MAV_LANDED_STATE_ON_GROUND
        send.extended_sys_state_send(0, landed)

    def _hear(self, message, now):
        kind = message.get_type()
        if kind in ("COMMAND_LONG", "COMMAND_INT"):
            self._command(message, now)
        elif kind == "SET_POSITION_TARGET_GLOBAL_INT":
            self.setpoint_at = now
            if self.mode == OFFBOARD:
                north = (message.lat_int / 1e7 - self.home[0]) * METRES_PER_DEGREE
                east = (message.lon_int / 1e7 - self.home[1]) * METRES_PER_DEGREE
                self.target = np.array([east * math.cos(math.radians(self.home[0])), north, message.alt])
        elif kind == "PARAM_SET":
            self.parameters[message.param_id] = message.param_value
            self._parameter(message.param_id)
        elif kind == "PARAM_REQUEST_READ" and message.param_id in self.parameters:
            self._parameter(message.param_id)
        elif kind == "MISSION_COUNT" and message.mission_type == mavlink.MAV_MISSION_TYPE_FENCE:
            self.fence, self._expected = [], message.count
            self._ask_for_item(message)
        elif kind == "MISSION_ITEM_INT" and message.seq == len(self.fence):
            self.fence.append((message.x / 1e7, message.y / 1e7))
            self._ask_for_item(message)

    def _ask_for_item(self, message):
        whom = (message.get_srcSystem(), message.get_srcComponent())
        if len(self.fence) < self._expected:
            self._link.mav.mission_request_int_send(*whom, len(self.fence), mavlink.MAV_MISSION_TYPE_FENCE)
        else:
            self._link.mav.mission_ack_send(*whom, mavlink.MAV_MISSION_ACCEPTED, mavlink.MAV_MISSION_TYPE_FENCE)

    def _parameter(self, name):
        self._link.mav.param_value_send(
            name.encode(), self.parameters[name], mavlink.MAV_PARAM_TYPE_REAL32, len(self.parameters), 0
        )

    def _command(self, message, now):
        command, taken = message.command, mavlink.MAV_RESULT_ACCEPTED
        if command in self.refuse:
            taken = mavlink.MAV_RESULT_DENIED
        elif command == mavlink.MAV_CMD_COMPONENT_ARM_DISARM:
            self.armed = message.param1 > 0.5
        elif command == mavlink.MAV_CMD_NAV_TAKEOFF:
            self._enter(TAKEOFF)
            self.target = np.array([*self.airframe.position[:2], self.parameters["MIS_TAKEOFF_ALT"]])
        elif command == mavlink.MAV_CMD_NAV_LAND:
            self._enter(LAND)
        elif command == mavlink.MAV_CMD_DO_SET_MODE:
            mode = (int(message.param2), int(message.param3))
            if mode == OFFBOARD and now - self.setpoint_at > 1.0 * self.pace:
                taken = mavlink.MAV_RESULT_DENIED  # setpoints have to come first
            else:
                self._enter(mode)
        elif command == mavlink.MAV_CMD_DO_CHANGE_SPEED:
            self.speed = message.param2
        elif command == mavlink.MAV_CMD_REQUEST_MESSAGE and message.param1 == mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION:
            pass
        else:
            taken = mavlink.MAV_RESULT_UNSUPPORTED
        self._link.mav.command_ack_send(command, taken, 0, 0, message.get_srcSystem(), message.get_srcComponent())
        self._beat()
        if command == mavlink.MAV_CMD_REQUEST_MESSAGE and taken == mavlink.MAV_RESULT_ACCEPTED:
            able = (
                mavlink.MAV_PROTOCOL_CAPABILITY_MISSION_FENCE
                | mavlink.MAV_PROTOCOL_CAPABILITY_MISSION_INT
                | mavlink.MAV_PROTOCOL_CAPABILITY_MAVLINK2
                | mavlink.MAV_PROTOCOL_CAPABILITY_COMMAND_INT
            )
            self._link.mav.autopilot_version_send(able, 0, 0, 0, 0, [0] * 8, [0] * 8, [0] * 8, 0, 0, 0)
