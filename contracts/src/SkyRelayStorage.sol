// SPDX-License-Identifier: Apache-2.0
pragma solidity 0.8.26;

import {ISkyRelayTypes} from "./interfaces/ISkyRelayTypes.sol";
import {Member, MemberLibrary, Proposal, Session, Zone} from "./libraries/Records.sol";

/// @title The storage that SkyRelay and its extension share, and how it is read
abstract contract SkyRelayStorage is ISkyRelayTypes {
    /// @notice Runs allocations and resets, assigns models.
    bytes32 public constant COORDINATOR_ROLE = keccak256("COORDINATOR_ROLE");
    /// @notice Registers models.
    bytes32 public constant PUBLISHER_ROLE = keccak256("PUBLISHER_ROLE");
    /// @notice Sets reputations.
    bytes32 public constant REPUTATION_ROLE = keccak256("REPUTATION_ROLE");

    /// @dev Proposals that one UAV takes in one session: what bounds the gas of one UAV's allocation.
    uint256 internal constant MAX_PROPOSALS = 1024;
    /// @dev UAVs in one zone's list.
    uint256 internal constant MAX_ZONE_UAVS = 65_535;
    /// @dev Battery and reputation of 100.
    uint256 internal constant HUNDRED = 10_000;

    /// @dev A session's lists. Two sets alternate, so that the last finished session can still be rated; what they
    /// held before is overwritten, never cleared. Bit i of `selected` belongs to proposal i, where i < decided.
    struct Lists {
        Proposal[MAX_PROPOSALS] proposals;
        uint256[MAX_PROPOSALS / 256] selected;
    }

    /// @dev Three slots. The CID is 0x01, codec, 0x12, 0x20, digest.
    struct Model {
        ModelCard card;
        address owner;
        bytes1 codec;
        bool retired;
        bytes32 digest;
    }

    /// @dev What the extension needs of the parameters.
    struct Rules {
        uint16 ratingStep;
        uint16 observationSide;
        uint8 channels;
        uint8 actions;
    }

    // Each part writes some of these and reads all: seen alone, the extension reads what nothing has written.
    // slither-disable-start uninitialized-state
    Rules internal _rules;
    address[] internal _uavList;
    bytes32[] internal _modelList;
    mapping(address member => Member record) internal _members;
    mapping(uint256 uavIndex => Session session) internal _sessions;
    mapping(uint256 uavIndex => Lists[2] lists) internal _lists;
    mapping(uint256 zone => Zone state) internal _zones;
    /// @dev How many there are stands in the zone; what is beyond is left over, never cleared.
    mapping(uint256 zone => uint24[MAX_ZONE_UAVS] uavIndices) internal _zoneUAVs;
    mapping(uint256 zone => bytes32 modelId) internal _zoneModels;
    mapping(bytes32 modelId => Model model) internal _models;
    // slither-disable-end uninitialized-state

    // Records: what is unknown reverts

    function _requireAtMost(uint256 value, uint256 maximum) internal pure {
        if (value > maximum) revert OutOfRange(value, maximum);
    }

    function _uav(address uav) internal view returns (Member u) {
        u = _members[uav];
        if (u.kind() != MemberLibrary.UAV) revert UnknownUAV(uav);
    }

    function _vehicle(address vehicle) internal view returns (Member v) {
        v = _members[vehicle];
        if (v.kind() != MemberLibrary.VEHICLE) revert UnknownVehicle(vehicle);
    }

    function _zone(uint256 zone) internal view returns (Zone z) {
        z = _zones[zone];
        if (Zone.unwrap(z) == 0) revert UnknownZone(uint32(zone));
    }

    // Sessions

    /// @dev The session of a UAV, and whether it belongs to the current period of the UAV's zone.
    function _session(Member u) internal view returns (Session s, bool current) {
        uint256 zone = u.uavZone();
        s = _sessions[u.index()];
        current = s.key() == _zones[zone].key(zone);
    }

    /// @dev Where a vehicle's latest proposal stands in the current period of its zone, and the session it is in.
    function _status(Member v, Zone z) internal view returns (ProposalStatus, Session s) {
        if (v.proposedSession() == 0) return (ProposalStatus.None, s);
        s = _sessions[v.proposedUAV()];
        if (v.proposedSession() != s.number() || s.key() != z.key(v.vehicleZone())) return (ProposalStatus.None, s);
        return (_decision(_listsOf(v.proposedUAV(), s.number()), s.decided(), v.proposedIndex()), s);
    }

    function _decision(Lists storage lists, uint256 decided, uint256 i) internal view returns (ProposalStatus) {
        if (i >= decided) return ProposalStatus.Pending;
        return _isSelected(lists, i) ? ProposalStatus.Selected : ProposalStatus.Rejected;
    }

    function _isSelected(Lists storage lists, uint256 i) internal view returns (bool) {
        return lists.selected[i >> 8] >> (i & 0xff) & 1 != 0;
    }

    function _listsOf(uint256 uavIndex, uint256 session) internal view returns (Lists storage) {
        return _lists[uavIndex][session & 1];
    }
}
