// SPDX-License-Identifier: Apache-2.0
pragma solidity 0.8.26;

import {SkyRelayRules} from "./SkyRelayRules.sol";
import {
    Member,
    MemberLibrary,
    Past,
    PlaceLibrary,
    Proposal,
    ProposalLibrary,
    Session,
    TermsLibrary,
    Zone
} from "./libraries/Records.sol";

/// @title What SkyRelay and its extension share: storage, and what becomes of a proposal
abstract contract SkyRelayBase is SkyRelayRules {
    /// @dev Open and selected proposals that one UAV has at a time: what bounds the gas of one UAV's allocation.
    uint256 internal constant MAX_PROPOSALS = 1024;
    /// @dev Places of a session's list, those of rejected proposals included.
    uint256 internal constant MAX_PLACES = 65_535;
    /// @dev UAVs in one zone's list.
    uint256 internal constant MAX_ZONE_UAVS = 65_535;

    /// @dev A session's lists. Two sets alternate, so that the last session that served somebody can still be rated;
    /// what they held before is overwritten, never cleared. Bit i of `selected` belongs to proposal i, where
    /// i < decided.
    struct Lists {
        Proposal[MAX_PLACES] proposals;
        uint256[MAX_PLACES / 256 + 1] selected;
    }

    /// @dev Three slots. The CID is 0x01, codec, 0x12, 0x20, digest.
    struct Model {
        ModelCard card;
        address owner;
        bytes1 codec;
        bool retired;
        bytes32 digest;
    }

    // Each part writes some of these and reads all: seen alone, one reads what nothing has written.
    // slither-disable-start uninitialized-state,unused-state
    address[] internal _uavList;
    bytes32[] internal _modelList;
    mapping(address member => Member record) internal _members;
    mapping(uint256 uavIndex => Session session) internal _sessions;
    mapping(uint256 uavIndex => Lists[2] lists) internal _lists;
    mapping(uint256 zone => Zone state) internal _zones;
    /// @dev How many there are stands in the zone; what is beyond is left over, never cleared.
    mapping(uint256 zone => uint24[MAX_ZONE_UAVS] uavIndices) internal _zoneUAVs;
    mapping(uint256 zone => bytes32 modelId) internal _zoneModels;
    mapping(uint256 zone => address account) internal _coordinators;
    mapping(bytes32 modelId => Model model) internal _models;
    mapping(address member => Past before) internal _past;
    // slither-disable-end uninitialized-state,unused-state

    constructor(Parameters memory p) SkyRelayRules(p) {}

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

    // Proposals

    /// @dev Take a proposal with what stands in `v`, and write `v`.
    /// @param status of the vehicle's latest proposal.
    /// @return refusal the error that keeps it out, encoded; empty where it was taken.
    function _propose(
        address vehicle,
        Member v,
        ProposalStatus status,
        address uav,
        Member u,
        uint256 demand,
        uint256 round
    ) internal returns (bytes memory refusal) {
        uint256 zone = u.uavZone();
        Zone z = _zones[zone];
        uint256 score;
        uint256 qov;
        (refusal, qov, score) = _judge(vehicle, v, status, uav, u, z, demand, round);
        if (refusal.length != 0) return refusal;
        Session s = _sessions[u.index()];
        if (s.key() != z.key(zone)) s = s.next().begun(z.key(zone));
        else if (s.closed()) return abi.encodeWithSelector(UAVClosed.selector, uav);
        uint256 index = s.count();
        if (index - s.decided() + s.selected() == MAX_PROPOSALS || index == MAX_PLACES) {
            return abi.encodeWithSelector(ProposalListFull.selector, uav);
        }
        if (!z.waiting()) _zones[zone] = z.withWaiting();
        _sessions[u.index()] = s.withOneMore();
        _lists[u.index()][s.list()].proposals[index] = ProposalLibrary.pack(vehicle, demand, score);
        _members[vehicle] = v.withProposal(u.index(), s.number(), index);
        emit VehSelectionSubmitted(
            vehicle,
            uav,
            uint32(zone),
            TermsLibrary.pack(v, u, demand),
            PlaceLibrary.pack(qov, score, s.number(), index, round)
        );
    }

    /// @dev Eq. 2 and the score of a proposal; or why it is refused, whatever the UAV's list holds.
    // slither-disable-next-line cyclomatic-complexity (one reason after the other)
    function _judge(
        address vehicle,
        Member v,
        ProposalStatus status,
        address uav,
        Member u,
        Zone z,
        uint256 demand,
        uint256 round
    ) private view returns (bytes memory refusal, uint256 qov, uint256 score) {
        uint256 zone = u.uavZone();
        if (zone == 0 || v.vehicleZone() != zone) {
            refusal = abi.encodeWithSelector(DifferentZone.selector, v.vehicleZone(), zone);
        } else if (z.suspended()) {
            refusal = abi.encodeWithSelector(SuspendedZone.selector, zone);
        } else if (v.suspended() || u.suspended()) {
            refusal = abi.encodeWithSelector(Suspended.selector, v.suspended() ? vehicle : uav);
        } else if (z.allocating()) {
            refusal = abi.encodeWithSelector(ZoneAllocating.selector, zone);
        } else if (z.claimed()) {
            refusal = abi.encodeWithSelector(ZoneClaimed.selector, zone);
        } else if (round != z.round()) {
            refusal = abi.encodeWithSelector(WrongRound.selector, round, z.round());
        } else if (u.battery() == 0) {
            refusal = abi.encodeWithSelector(UAVEmpty.selector, uav);
        } else if (_isStale(u)) {
            refusal = abi.encodeWithSelector(UAVStale.selector, uav, u.timestamp());
        } else if (status == ProposalStatus.Pending) {
            refusal = abi.encodeWithSelector(ProposalOpen.selector, vehicle);
        } else if (status == ProposalStatus.Selected) {
            refusal = abi.encodeWithSelector(AlreadySelected.selector, vehicle);
        } else if (status == ProposalStatus.Rejected && v.proposedUAV() == u.index()) {
            refusal = abi.encodeWithSelector(AlreadyRejected.selector, vehicle, uav);
        } else if (demand == 0 || demand > MAX_DEMAND) {
            refusal = abi.encodeWithSelector(OutOfRange.selector, demand, MAX_DEMAND);
        } else {
            uint256 distance;
            (qov, score, distance) = _quality(v, u, demand);
            if (RANGE_GATE && distance > MAX_DISTANCE) {
                refusal = abi.encodeWithSelector(TooFar.selector, distance, MAX_DISTANCE);
            }
        }
    }

    /// @dev Take a vehicle's open or selected proposal back. An open one's place goes to the last of the list; a
    /// selection stays, without its demand, for the UAV to rate.
    function _withdraw(address vehicle, Member v, ProposalStatus status, Session s) internal returns (Member) {
        uint256 zone = v.vehicleZone();
        uint256 uav = v.proposedUAV();
        uint256 index = v.proposedIndex();
        Lists storage lists = _lists[uav][s.list()];
        Proposal[MAX_PLACES] storage proposals = lists.proposals;
        emit VehSelectionWithdrawn(vehicle, _uavList[uav], uint32(s.number()), uint16(index));
        if (status == ProposalStatus.Selected) {
            Proposal p = proposals[index];
            proposals[index] = p.givenUp();
            lists.selected[index >> 8] &= ~(1 << (index & 0xff));
            _sessions[uav] = s.withOneSelectedLess(p.demand());
            _zones[zone] = _zones[zone].withSelection(s.selected(), s.selected() - 1);
        } else {
            uint256 last = s.count() - 1;
            if (index != last) {
                Proposal moved = proposals[last];
                proposals[index] = moved;
                _members[moved.vehicle()] = _members[moved.vehicle()].withProposal(uav, s.number(), index);
            }
            _sessions[uav] = s.withOneFewer();
        }
        return v.withProposal(0, 0, 0);
    }

    // Sessions

    /// @dev The session of a UAV, and whether it belongs to the current period of the UAV's zone.
    function _session(Member u) internal view returns (Session s, bool current) {
        uint256 zone = u.uavZone();
        s = _sessions[u.index()];
        current = s.key() == _zones[zone].key(zone);
    }

    /// @dev Void a UAV's proposals and selections: their vehicles are free at once, without being written. The UAV
    /// takes no others until the next period, so that it cannot get rid of those whom it does not want.
    function _endSession(address uav, Member u) internal {
        (Session s, bool current) = _session(u);
        if (s.count() == 0) return;
        uint256 zone = u.uavZone();
        if (current && s.selected() != 0) _zones[zone] = _zones[zone].withSelection(s.selected(), 0);
        s = s.voided();
        _sessions[u.index()] = s;
        emit UAVSubmissionReset(uav, uint32(s.number()));
    }

    /// @dev Where a vehicle's latest proposal stands in the current period of its zone, and the session it is in.
    function _status(Member v) internal view returns (ProposalStatus, Session s) {
        if (v.proposedSession() == 0) return (ProposalStatus.None, s);
        s = _sessions[v.proposedUAV()];
        uint256 zone = v.vehicleZone();
        if (v.proposedSession() != s.number() || s.key() != _zones[zone].key(zone)) return (ProposalStatus.None, s);
        return (_decision(_lists[v.proposedUAV()][s.list()], s.decided(), v.proposedIndex()), s);
    }

    function _decision(Lists storage lists, uint256 decided, uint256 i) internal view returns (ProposalStatus) {
        if (i >= decided) return ProposalStatus.Pending;
        return _isSelected(lists, i) ? ProposalStatus.Selected : ProposalStatus.Rejected;
    }

    function _isSelected(Lists storage lists, uint256 i) internal view returns (bool) {
        return lists.selected[i >> 8] >> (i & 0xff) & 1 != 0;
    }
}
