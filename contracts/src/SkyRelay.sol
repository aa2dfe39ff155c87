// SPDX-License-Identifier: Apache-2.0
pragma solidity 0.8.26;

import {AccessControl} from "@openzeppelin/contracts/access/AccessControl.sol";
import {Math} from "@openzeppelin/contracts/utils/math/Math.sol";
import {SkyRelayStorage} from "./SkyRelayStorage.sol";
import {ISkyRelay} from "./interfaces/ISkyRelay.sol";
import {ProposalHeap} from "./libraries/ProposalHeap.sol";
import {Quality} from "./libraries/Quality.sol";
import {Member, MemberLibrary, Proposal, ProposalLibrary, Session, Zone, ZoneLibrary} from "./libraries/Records.sol";

/// @title SkyRelay: the interface ISkyRelay says what each function does
/// @notice What stands in ISkyRelayExtension is called at this address too and runs in the extension's code.
contract SkyRelay is SkyRelayStorage, AccessControl, ISkyRelay {
    uint256 private constant WEIGHT_SUM = 1e6;

    uint256 private immutable DEMAND_COEFFICIENT;
    uint256 private immutable PAYMENT_COEFFICIENT;
    uint256 private immutable REPUTATION_COEFFICIENT;
    uint256 private immutable CLOSENESS_COEFFICIENT;
    uint256 private immutable DENOMINATOR;
    uint256 private immutable MAX_DISTANCE; // [1e-16 m]
    bool private immutable RANGE_GATE;
    uint256 private immutable MAX_BANDWIDTH;
    uint256 private immutable MAX_DEMAND;
    uint256 private immutable MAX_PAYMENT;
    uint16 private immutable INITIAL_REPUTATION;
    address private immutable EXTENSION;

    constructor(Parameters memory p, address extension) {
        uint256 qou = 0;
        uint256 qov = 0;
        for (uint256 i = 0; i < 4; ++i) {
            qou += p.qouWeights[i];
            qov += p.qovWeights[i];
        }
        if (
            qou != WEIGHT_SUM || qov != WEIGHT_SUM || p.maxBandwidth == 0 || p.maxDemand == 0 || p.maxPayment == 0
                || p.maxDistance == 0 || p.initialReputation > HUNDRED
                || p.ratingStep > HUNDRED || p.channels == 0 || p.actions == 0 || extension.code.length == 0
        ) revert InvalidParameters();
        (uint256[4] memory numerators, uint256 denominator) =
            Quality.coefficients(p.qovWeights, p.maxDemand, p.maxPayment, p.maxDistance);
        DEMAND_COEFFICIENT = numerators[0];
        PAYMENT_COEFFICIENT = numerators[1];
        REPUTATION_COEFFICIENT = numerators[2];
        CLOSENESS_COEFFICIENT = numerators[3];
        DENOMINATOR = denominator;
        MAX_DISTANCE = p.maxDistance * Quality.DISTANCE_SCALE;
        RANGE_GATE = p.rangeGate;
        MAX_BANDWIDTH = p.maxBandwidth;
        MAX_DEMAND = p.maxDemand;
        MAX_PAYMENT = p.maxPayment;
        INITIAL_REPUTATION = p.initialReputation;
        EXTENSION = extension;
        _rules = Rules({
            ratingStep: p.ratingStep,
            observationSide: p.observationSide,
            channels: p.channels,
            actions: p.actions
        });
        emit Deployed(p, extension);
        _grantRole(DEFAULT_ADMIN_ROLE, msg.sender);
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
        _requireNewMember();
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
        _requireNewMember();
        _requireAtMost(payment, MAX_PAYMENT);
        _members[msg.sender] = Member.wrap(
            MemberLibrary.vehicleInfo(x, y, payment, zone) | MemberLibrary.VEHICLE << 160
                | uint256(INITIAL_REPUTATION) << 168
        );
        emit VehicleRegistered(msg.sender, x, y, payment, INITIAL_REPUTATION, zone);
    }

    /// @inheritdoc ISkyRelay
    function updateVehicleInfo(int32 x, int32 y, uint32 payment, uint32 zone) external {
        Member v = _vehicle(msg.sender);
        _requireAtMost(payment, MAX_PAYMENT);
        if (zone != v.vehicleZone()) v = _withdraw(v);
        _members[msg.sender] = v.withInfo(MemberLibrary.vehicleInfo(x, y, payment, zone));
        emit VehicleUpdated(msg.sender, x, y, payment, zone);
    }

    /// @inheritdoc ISkyRelay
    function updateUAVInfo(int32 x, int32 y, uint16 altitude, uint16 battery, uint32 bandwidth) external {
        Member u = _uav(msg.sender);
        uint256 info = _uavInfo(x, y, altitude, battery, bandwidth);
        if (battery == 0) {
            _endSession(msg.sender, u);
        } else if (bandwidth < u.bandwidth() && bandwidth < _sessions[u.index()].committed()) {
            // Whether the session is the current period's takes another slot to know, which most updates do not need.
            uint256 committed = _committed(u);
            if (bandwidth < committed) revert BandwidthCommitted(bandwidth, uint32(committed));
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

    // Selection

    /// @inheritdoc ISkyRelay
    function submitVehSelection(address uav, uint32 demand, uint32 round) external {
        Member v = _vehicle(msg.sender);
        Member u = _uav(uav);
        uint256 zone = u.uavZone();
        if (zone == 0 || v.vehicleZone() != zone) revert DifferentZone(uint32(v.vehicleZone()), uint32(zone));
        Zone z = _zones[zone];
        if (z.allocating()) revert ZoneAllocating(uint32(zone));
        if (round != z.round()) revert WrongRound(round, uint32(z.round()));
        if (u.battery() == 0) revert UAVEmpty(uav);
        (ProposalStatus status,) = _status(v, z);
        if (status == ProposalStatus.Pending) revert ProposalOpen(msg.sender);
        if (status == ProposalStatus.Selected) revert AlreadySelected(msg.sender);
        if (status == ProposalStatus.Rejected && v.proposedUAV() == u.index()) revert AlreadyRejected(msg.sender, uav);
        (uint256 qov, uint256 score, uint256 distance) = _quality(v, u, demand);
        if (RANGE_GATE && distance > MAX_DISTANCE) revert TooFar(distance, MAX_DISTANCE);

        Session s = _sessions[u.index()];
        if (s.key() != z.key(zone)) s = s.next().begun(z.key(zone));
        uint256 index = s.count();
        if (index == MAX_PROPOSALS) revert ProposalListFull(uav);
        _sessions[u.index()] = s.withOneMore();
        _listsOf(u.index(), s.number()).proposals[index] = ProposalLibrary.pack(msg.sender, demand, score);
        _members[msg.sender] = v.withProposal(u.index(), s.number(), index);
        emit VehSelectionSubmitted(
            msg.sender,
            uav,
            uint32(zone),
            round,
            uint32(s.number()),
            uint16(index),
            demand,
            uint64(qov),
            uint64(score)
        );
    }

    /// @inheritdoc ISkyRelay
    function allocateZone(uint32 zone, uint256 maxProposals) external onlyRole(COORDINATOR_ROLE) returns (bool done) {
        Zone z = _zone(zone);
        if (maxProposals == 0) revert NoWork();
        uint24[MAX_ZONE_UAVS] storage list = _zoneUAVs[zone];
        uint256 length = z.uavs();
        uint256 cursor = z.cursor();
        uint256 work = 0;
        for (; cursor < length; ++cursor) {
            uint256 index = list[cursor];
            Session s = _sessions[index];
            bool undecided = s.key() == z.key(zone) && s.decided() < s.count();
            uint256 cost = undecided ? s.count() - s.decided() + s.selected() : 1;
            if (work != 0 && work + cost > maxProposals) break;
            work += cost;
            if (undecided) z = _allocateUAV(zone, z, index, s);
        }
        done = cursor == length;
        if (done) {
            emit ZoneAllocated(
                zone,
                uint32(z.period()),
                uint32(z.round()),
                uint32(z.selectedUAVs()),
                uint32(z.selectedVehicles())
            );
        }
        _zones[zone] = done ? z.nextRound() : z.paused(cursor);
    }

    /// @inheritdoc ISkyRelay
    function resetListsForZone(uint32 zone) external onlyRole(COORDINATOR_ROLE) {
        Zone z = _zone(zone).nextPeriod();
        _zones[zone] = z;
        emit ZoneListsReset(zone, uint32(z.period()), uint32(z.round()));
    }

    /// @inheritdoc ISkyRelay
    function resetUAVSubmission(address uav) external {
        Member u = _uav(uav);
        if (msg.sender != uav) _checkRole(COORDINATOR_ROLE);
        _endSession(uav, u);
    }

    /// @inheritdoc ISkyRelay
    function determineMDRLModel(uint32 zone) external onlyRole(COORDINATOR_ROLE) returns (bytes32 modelId) {
        Zone z = _zone(zone);
        if (z.allocating()) revert ZoneAllocating(zone);
        uint256 uavs = z.selectedUAVs();
        uint256 vehicles = z.selectedVehicles();
        if (uavs == 0) revert NothingSelected(zone);
        uint256 length = _modelList.length;
        if (length == 0) revert NoModels();
        uint256 best = type(uint256).max;
        for (uint256 i = 0; i < length; ++i) {
            bytes32 candidate = _modelList[i];
            ModelCard memory card = _models[candidate].card;
            // Lexicographic: UAVs outside the trained range, vehicles outside it, then the score, higher first.
            uint256 rank = _outside(uavs, card.minUAVs, card.maxUAVs) << 96
                | _outside(vehicles, card.minVehicles, card.maxVehicles) << 64
                | uint256(int256(type(int32).max) - card.score);
            if (rank < best) {
                best = rank;
                modelId = candidate;
            }
        }
        _zoneModels[zone] = modelId;
        _zones[zone] = z.withModel();
        emit ModelAssigned(zone, modelId, uint32(z.round()), uint32(uavs), uint32(vehicles));
    }

    // Views

    /// @inheritdoc ISkyRelay
    function getZoneUAV(uint32 zone) external view returns (address[] memory uavs) {
        uavs = new address[](_zone(zone).uavs());
        uint24[MAX_ZONE_UAVS] storage list = _zoneUAVs[zone];
        for (uint256 i = 0; i < uavs.length; ++i) {
            uavs[i] = _uavList[list[i]];
        }
    }

    /// @inheritdoc ISkyRelay
    function getUAVInfo(address uav) external view returns (UAVInfo memory) {
        Member u = _uav(uav);
        return UAVInfo({
            x: int32(u.x()),
            y: int32(u.y()),
            altitude: uint16(u.altitude()),
            battery: uint16(u.battery()),
            reputation: uint16(u.reputation()),
            bandwidth: uint32(u.bandwidth()),
            available: uint32(u.bandwidth() - _committed(u)),
            zone: uint32(u.uavZone()),
            timestamp: uint40(u.timestamp()),
            index: uint24(u.index())
        });
    }

    /// @inheritdoc ISkyRelay
    function quality(address vehicle, address uav, uint32 demand) external view returns (uint64 qov, uint64 score) {
        (uint256 q, uint256 s,) = _quality(_vehicle(vehicle), _uav(uav), demand);
        return (uint64(q), uint64(s));
    }

    // Allocation

    /// @dev Algorithm 2 for one UAV: what it holds and what is new, together, against its whole bandwidth.
    function _allocateUAV(uint256 zone, Zone z, uint256 index, Session s) private returns (Zone) {
        address uav = _uavList[index];
        uint256 bandwidth = _members[uav].bandwidth();
        Lists storage lists = _listsOf(index, s.number());
        (uint256[] memory heap, address[] memory vehicles) = _load(lists, s);
        uint256 size = heap.length;
        ProposalHeap.build(heap, size);

        // slither-disable-next-line uninitialized-local (memory arrays begin as zeros)
        uint256[MAX_PROPOSALS / 256] memory bits;
        uint256 left = bandwidth;
        uint256 taken = 0;
        uint256 misfits = 0;
        uint256 patience = 1;
        while (size != 0) {
            uint256 best = ProposalHeap.pop(heap, size);
            unchecked {
                --size;
                uint256 demand = uint32(best);
                if (demand > left) {
                    // What does not fit now never will. Doubling the patience bounds the passes by log n.
                    if (++misfits == patience) {
                        size = ProposalHeap.keepFitting(heap, size, left);
                        patience <<= 1;
                        misfits = 0;
                    }
                    continue;
                }
                left -= demand;
                uint256 i = type(uint16).max - uint16(best >> 176);
                bits[i >> 8] |= 1 << (i & 0xff);
                // Each proposal that is popped leaves a word free at the end.
                heap[heap.length - ++taken] = uint16(best >> 32);
            }
        }
        address[] memory selected = new address[](taken);
        for (uint256 i = 0; i < taken; ++i) {
            selected[i] = vehicles[heap[heap.length - 1 - i]];
        }
        for (uint256 w = 0; w << 8 < s.count(); ++w) {
            lists.selected[w] = bits[w];
        }
        z = z.withSelection(s.selected(), taken);
        _sessions[index] = s.withSelection(taken, bandwidth - left);
        emit UAVAllocated(
            uav,
            uint32(zone),
            uint32(z.round()),
            uint32(s.number()),
            uint16(s.count()),
            uint32(bandwidth - left),
            selected
        );
        return z;
    }

    /// @dev The proposals that a UAV holds and the undecided ones.
    /// @return heap a word each, the larger the better: score, then the earlier submission; below place and demand.
    /// @return vehicles by place.
    // slither-disable-next-line assembly (shortens the array in place)
    function _load(Lists storage lists, Session s)
        private
        view
        returns (uint256[] memory heap, address[] memory vehicles)
    {
        uint256 count = s.count();
        uint256 decided = s.decided();
        uint256 size = count - decided + s.selected();
        heap = new uint256[](size);
        vehicles = new address[](size);
        size = 0;
        unchecked {
            for (uint256 i = 0; i < count; ++i) {
                if (i < decided && !_isSelected(lists, i)) continue;
                Proposal p = lists.proposals[i];
                if (Proposal.unwrap(p) == 0) continue; // withdrawn
                vehicles[size] = p.vehicle();
                heap[size] = p.score() << 192 | (type(uint16).max - i) << 176 | size << 32 | p.demand();
                ++size;
            }
        }
        assembly ("memory-safe") {
            mstore(heap, size) // withdrawn proposals left room
        }
    }

    // Sessions

    /// @dev Bandwidth that a UAV has promised in the current period.
    function _committed(Member u) private view returns (uint256) {
        (Session s, bool current) = _session(u);
        return current ? s.committed() : 0;
    }

    /// @dev Void a UAV's proposals and selections: their vehicles are free at once, without being written.
    function _endSession(address uav, Member u) private {
        (Session s, bool current) = _session(u);
        if (s.count() == 0) return;
        uint256 zone = u.uavZone();
        if (current && s.selected() != 0) _zones[zone] = _zones[zone].withSelection(s.selected(), 0);
        s = s.next();
        _sessions[u.index()] = s;
        emit UAVSubmissionReset(uav, uint32(s.number()));
    }

    /// @dev Take the caller's open or selected proposal, if it has one, from its UAV's list.
    function _withdraw(Member v) private returns (Member) {
        uint256 zone = v.vehicleZone();
        Zone z = _zones[zone];
        (ProposalStatus status, Session s) = _status(v, z);
        if (status != ProposalStatus.Pending && status != ProposalStatus.Selected) return v;
        uint256 index = v.proposedIndex();
        Lists storage lists = _listsOf(v.proposedUAV(), s.number());
        if (status == ProposalStatus.Selected) {
            lists.selected[index >> 8] &= ~(1 << (index & 0xff));
            _sessions[v.proposedUAV()] = s.withOneLess(lists.proposals[index].demand());
            _zones[zone] = z.withSelection(s.selected(), s.selected() - 1);
        }
        lists.proposals[index] = Proposal.wrap(0);
        emit VehSelectionWithdrawn(msg.sender, _uavList[v.proposedUAV()], uint32(s.number()), uint16(index));
        return v.withProposal(0, 0, 0);
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

    // Arithmetic

    function _quality(Member v, Member u, uint256 demand)
        private
        view
        returns (uint256 qov, uint256 score, uint256 distance)
    {
        if (demand == 0) revert OutOfRange(demand, MAX_DEMAND);
        _requireAtMost(demand, MAX_DEMAND);
        unchecked {
            distance = Quality.distance(v.x() - u.x(), v.y() - u.y());
            // Each term is below 2^218: see Quality.coefficients.
            qov = (
                DEMAND_COEFFICIENT * demand + PAYMENT_COEFFICIENT * v.payment()
                    + REPUTATION_COEFFICIENT * v.reputation()
                    + CLOSENESS_COEFFICIENT * Math.saturatingSub(MAX_DISTANCE, distance)
            ) / DENOMINATOR;
        }
        score = Quality.score(qov, demand);
    }

    function _outside(uint256 value, uint256 low, uint256 high) private pure returns (uint256) {
        if (value < low) return low - value;
        return value > high ? value - high : 0;
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

    function _requireNewMember() private view {
        if (Member.unwrap(_members[msg.sender]) != 0) revert AlreadyRegistered(msg.sender);
    }
}
