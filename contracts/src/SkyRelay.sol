// SPDX-License-Identifier: Apache-2.0
pragma solidity 0.8.26;

import {Address} from "@openzeppelin/contracts/utils/Address.sol";
import {SkyRelayBase} from "./SkyRelayBase.sol";
import {ISkyRelay} from "./interfaces/ISkyRelay.sol";
import {ISkyRelayExtension} from "./interfaces/ISkyRelayExtension.sol";
import {Member, MemberLibrary, Session, Zone, ZoneLibrary} from "./libraries/Records.sol";

/// @title SkyRelay: what its members call; the interface ISkyRelay says what each function does
/// @notice What stands in ISkyRelayExtension is called at this address too and runs in the extension's code.
contract SkyRelay is SkyRelayBase, ISkyRelay {
    uint256 private immutable MAX_BANDWIDTH;
    uint16 private immutable INITIAL_REPUTATION;
    bool private immutable ADMISSION;
    address private immutable EXTENSION;

    constructor(Parameters memory p, address extension) SkyRelayBase(p) {
        if (extension.code.length == 0) revert InvalidParameters();
        MAX_BANDWIDTH = p.maxBandwidth;
        INITIAL_REPUTATION = p.initialReputation;
        ADMISSION = p.admission;
        EXTENSION = extension;
        emit Deployed(p, extension);
        // slither-disable-next-line unused-return (it returns nothing)
        Address.functionDelegateCall(extension, abi.encodeCall(ISkyRelayExtension.initialise, (msg.sender)));
    }

    /// @dev The extension, fixed at deployment, works on this contract's storage. Solidity can pass any call and any
    /// answer on in assembly only.
    // slither-disable-next-line assembly
    fallback() external {
        address extension = EXTENSION;
        assembly ("memory-safe") {
            let pointer := mload(0x40)
            calldatacopy(pointer, 0, calldatasize())
            let success := delegatecall(gas(), extension, pointer, calldatasize(), 0, 0)
            returndatacopy(pointer, 0, returndatasize())
            if iszero(success) { revert(pointer, returndatasize()) }
            return(pointer, returndatasize())
        }
    }

    // Registration and updates

    /// @inheritdoc ISkyRelay
    function registerUAV(int32 x, int32 y, uint16 altitude, uint16 battery, uint32 bandwidth, uint32 zone) external {
        _requireNewMember(MemberLibrary.UAV);
        uint256 info = _uavInfo(x, y, altitude, battery, bandwidth);
        uint256 index = _uavList.length;
        _requireAtMost(index, type(uint24).max);
        _uavList.push(msg.sender);
        // A slot that is not empty later costs a vehicle less to propose.
        _sessions[index] = Session.wrap(1);
        emit UAVRegistered(msg.sender, uint24(index), x, y, altitude, battery, INITIAL_REPUTATION, bandwidth);
        _members[msg.sender] = _enter(
            Member.wrap(info | MemberLibrary.UAV << 160 | uint256(INITIAL_REPUTATION) << 168 | index << 232), zone
        );
    }

    /// @inheritdoc ISkyRelay
    function registerVehicle(int32 x, int32 y, uint32 payment, uint32 zone) external {
        _requireNewMember(MemberLibrary.VEHICLE);
        _requireAtMost(payment, MAX_PAYMENT);
        _members[msg.sender] = Member.wrap(
            MemberLibrary.vehicleInfo(x, y, payment, zone, Member.wrap(0)) | MemberLibrary.VEHICLE << 160
                | uint256(INITIAL_REPUTATION) << 168
        );
        emit VehicleRegistered(msg.sender, x, y, payment, INITIAL_REPUTATION, zone);
    }

    /// @inheritdoc ISkyRelay
    function updateVehicleInfo(int32 x, int32 y, uint32 payment, uint32 zone) external {
        Member v = _vehicle(msg.sender);
        _requireAtMost(payment, MAX_PAYMENT);
        (ProposalStatus status, Session s) = _status(v);
        if (status == ProposalStatus.Pending || status == ProposalStatus.Selected) {
            if (zone == v.vehicleZone()) revert TermsFrozen(msg.sender);
            v = _withdraw(msg.sender, v, status, s);
        }
        _members[msg.sender] = v.withInfo(MemberLibrary.vehicleInfo(x, y, payment, zone, v));
        emit VehicleUpdated(msg.sender, x, y, payment, zone);
    }

    /// @inheritdoc ISkyRelay
    function updateUAVInfo(int32 x, int32 y, uint16 altitude, uint16 battery, uint32 bandwidth) external {
        Member u = _uav(msg.sender);
        uint256 info = _uavInfo(x, y, altitude, battery, bandwidth);
        if (battery == 0) {
            _endSession(msg.sender, u);
        } else if (bandwidth < u.bandwidth() && _sessions[u.index()].count() != 0) {
            // Whether the session is the current period's takes another slot to know, which most updates do not need.
            (, bool current) = _session(u);
            if (current) revert BandwidthCommitted(bandwidth, uint32(u.bandwidth()));
        }
        _members[msg.sender] = u.withInfo(info);
        emit UAVUpdated(msg.sender, x, y, altitude, battery, bandwidth);
    }

    /// @inheritdoc ISkyRelay
    function updateUAVZone(address uav, uint32 zone) external {
        Member u = _uav(uav);
        if (msg.sender != uav) revert NotOwnRecord(uav, msg.sender);
        if (zone == u.uavZone()) revert SameZone(zone);
        _endSession(uav, u);
        _leave(u);
        _members[uav] = _enter(u, zone);
    }

    /// @inheritdoc ISkyRelay
    function resetUAVSubmission(address uav) external {
        Member u = _uav(uav);
        if (msg.sender != uav && !_isStale(u) && !u.suspended()) revert NotOwnRecord(uav, msg.sender);
        _endSession(uav, u);
    }

    /// @inheritdoc ISkyRelay
    // slither-disable-next-line assembly (Solidity can pass an error on that it did not make in assembly only)
    function submitVehSelection(address uav, uint32 demand, uint32 round) external {
        Member v = _vehicle(msg.sender);
        (ProposalStatus status,) = _status(v);
        bytes memory refusal = _propose(msg.sender, v, status, uav, _uav(uav), demand, round);
        if (refusal.length == 0) return;
        assembly ("memory-safe") {
            revert(add(refusal, 0x20), mload(refusal))
        }
    }

    // Zones

    /// @dev Put a UAV that is in no zone's list into one; 0 leaves it in none.
    function _enter(Member u, uint32 zone) private returns (Member) {
        uint256 place = 0;
        if (zone != 0) {
            Zone z = _zones[zone];
            if (Zone.unwrap(z) == 0) {
                z = ZoneLibrary.opened();
                emit ZoneOpened(zone);
            }
            place = z.uavs();
            _requireAtMost(place, MAX_ZONE_UAVS - 1);
            _zoneUAVs[zone][place] = uint24(u.index());
            _zones[zone] = z.withOneMoreUAV();
        }
        emit UAVZoneUpdated(msg.sender, uint32(u.uavZone()), zone);
        return u.withZone(zone, place);
    }

    /// @dev Take a UAV off its zone's list. The last one fills the gap; during an allocation by way of the last
    /// decided one, so that the places below the cursor stay the decided ones.
    function _leave(Member u) private {
        uint256 zone = u.uavZone();
        if (zone == 0) return;
        Zone z = _zones[zone].withOneLessUAV();
        uint24[MAX_ZONE_UAVS] storage list = _zoneUAVs[zone];
        uint256 gap = u.place();
        if (gap < z.cursor()) {
            uint256 decided = z.cursor() - 1;
            z = z.withCursor(decided);
            _move(list, decided, gap);
            gap = decided;
        }
        _move(list, z.uavs(), gap);
        _zones[zone] = z;
    }

    function _move(uint24[MAX_ZONE_UAVS] storage list, uint256 from, uint256 to) private {
        if (from == to) return;
        uint24 index = list[from];
        list[to] = index;
        address uav = _uavList[index];
        _members[uav] = _members[uav].withPlace(to);
    }

    // Records

    function _uavInfo(int32 x, int32 y, uint256 altitude, uint256 battery, uint256 bandwidth)
        private
        view
        returns (uint256)
    {
        _requireAtMost(battery, HUNDRED);
        _requireAtMost(bandwidth, MAX_BANDWIDTH);
        return MemberLibrary.uavInfo(x, y, altitude, battery, bandwidth);
    }

    function _requireNewMember(uint256 kind) private view {
        Member m = _members[msg.sender];
        if (m.kind() == MemberLibrary.UAV || m.kind() == MemberLibrary.VEHICLE) revert AlreadyRegistered(msg.sender);
        if (ADMISSION && m.kind() != kind | MemberLibrary.ADMITTED) revert NotAdmitted(msg.sender);
    }
}
