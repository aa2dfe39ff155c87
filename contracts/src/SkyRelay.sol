// SPDX-License-Identifier: Apache-2.0
pragma solidity 0.8.26;

import {AccessControl} from "@openzeppelin/contracts/access/AccessControl.sol";
import {ISkyRelay} from "./interfaces/ISkyRelay.sol";
import {ProposalHeap} from "./libraries/ProposalHeap.sol";
import {Quality} from "./libraries/Quality.sol";

/// @title SkyRelay: the interface ISkyRelay says what each function does
contract SkyRelay is ISkyRelay, AccessControl {
    /// @notice Runs allocations and resets, assigns models.
    bytes32 public constant COORDINATOR_ROLE = keccak256("COORDINATOR_ROLE");
    /// @notice Registers models.
    bytes32 public constant PUBLISHER_ROLE = keccak256("PUBLISHER_ROLE");
    /// @notice Sets reputations.
    bytes32 public constant REPUTATION_ROLE = keccak256("REPUTATION_ROLE");

    /// @notice Proposals that one UAV takes in one session: what bounds the gas of one UAV's allocation.
    uint256 public constant MAX_PROPOSALS = 1024;
    /// @notice Models in the registry: what bounds the gas of `determineMDRLModel`.
    uint256 public constant MAX_MODELS = 64;

    uint256 private constant MAX_BATTERY = 10_000;
    uint256 private constant WEIGHT_SUM = 1e6;

    /// @dev One slot.
    struct UAV {
        int32 x;
        int32 y;
        uint16 altitude;
        uint16 battery;
        uint16 reputation;
        uint32 bandwidth;
        uint32 zone;
        uint40 timestamp;
        uint16 place; // in the zone's list
        uint24 index; // in the list of all UAVs
    }

    /// @dev One slot. The last three fields name the vehicle's latest proposal; session 0 is none.
    struct Vehicle {
        int32 x;
        int32 y;
        uint32 payment;
        uint16 reputation;
        uint32 zone;
        uint40 timestamp;
        uint24 uav;
        uint32 session;
        uint16 proposal;
    }

    /// @dev One slot: a UAV's proposals and selections in one period of one zone. It is over when the zone's period
    /// is another, or when the UAV left, ran empty or was reset; then the next session, without proposals, stands
    /// here with period 0.
    struct Session {
        uint32 number;
        uint32 zone;
        uint32 period;
        uint16 count; // proposals ever taken
        uint16 decided; // the first so many have been through an allocation
        uint16 selected; // vehicles held
        uint32 committed; // bandwidth promised to them
        uint16 decidedBefore; // `decided` of the session before, for its ratings
    }

    /// @dev One slot.
    struct Proposal {
        address vehicle;
        uint32 demand;
        uint64 score;
    }

    /// @dev A session's lists. Two sets alternate, so that the last finished session can still be rated; what they
    /// held before is overwritten, never cleared. Bit i of `selected` belongs to proposal i, where i < decided.
    struct Lists {
        Proposal[MAX_PROPOSALS] proposals;
        uint256[MAX_PROPOSALS / 256] selected;
    }

    /// @dev One slot.
    struct Zone {
        uint32 period;
        uint32 round;
        uint16 cursor;
        bool allocating;
        bool hasModel;
        uint16 selectedUAVs;
        uint32 selectedVehicles;
    }

    /// @dev Three slots. The CID is 0x01, codec, 0x12, 0x20, digest.
    struct Model {
        ModelCard card;
        address owner;
        bytes1 codec;
        bool retired;
        bytes32 digest;
    }

    uint256 private immutable DEMAND_COEFFICIENT;
    uint256 private immutable PAYMENT_COEFFICIENT;
    uint256 private immutable REPUTATION_COEFFICIENT;
    uint256 private immutable CLOSENESS_COEFFICIENT;
    uint256 private immutable DENOMINATOR;
    uint256 private immutable MAX_DISTANCE; // [1e-16 m]
    bool private immutable RANGE_GATE;
    uint32 private immutable MAX_BANDWIDTH;
    uint32 private immutable MAX_DEMAND;
    uint32 private immutable MAX_PAYMENT;
    uint16 private immutable INITIAL_REPUTATION;
    uint16 private immutable RATING_STEP;
    uint16 private immutable OBSERVATION_SIDE;
    uint8 private immutable CHANNELS;
    uint8 private immutable ACTIONS;

    address[] private _uavList;
    bytes32[] private _modelList;
    mapping(address uav => UAV record) private _uavs;
    mapping(address vehicle => Vehicle record) private _vehicles;
    mapping(uint256 uavIndex => Session session) private _sessions;
    mapping(uint256 uavIndex => Lists[2] lists) private _lists;
    mapping(uint32 zone => Zone state) private _zones;
    mapping(uint32 zone => uint24[] uavIndices) private _zoneUAVs;
    mapping(uint32 zone => bytes32 modelId) private _zoneModels;
    mapping(bytes32 modelId => Model model) private _models;

    constructor(Parameters memory p) {
        uint256 qou;
        uint256 qov;
        for (uint256 i = 0; i < 4; ++i) {
            qou += p.qouWeights[i];
            qov += p.qovWeights[i];
        }
        if (
            qou != WEIGHT_SUM || qov != WEIGHT_SUM || p.maxBandwidth == 0 || p.maxDemand == 0 || p.maxPayment == 0
                || p.maxDistance == 0 || p.initialReputation > Quality.MAX_REPUTATION
                || p.ratingStep > Quality.MAX_REPUTATION || p.channels == 0 || p.actions == 0
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
        RATING_STEP = p.ratingStep;
        OBSERVATION_SIDE = p.observationSide;
        CHANNELS = p.channels;
        ACTIONS = p.actions;
        emit Deployed(p);
        _grantRole(DEFAULT_ADMIN_ROLE, msg.sender);
    }

    // Registration and updates

    /// @inheritdoc ISkyRelay
    function registerUAV(int32 x, int32 y, uint16 altitude, uint16 battery, uint32 bandwidth, uint32 zone) external {
        _requireNewMember();
        _requireAtMost(battery, MAX_BATTERY);
        _requireAtMost(bandwidth, MAX_BANDWIDTH);
        uint256 index = _uavList.length;
        _requireAtMost(index, type(uint24).max);
        _uavList.push(msg.sender);
        // A slot that is not empty later costs a vehicle less to propose.
        _sessions[index].number = 1;
        emit UAVRegistered(msg.sender, uint24(index), x, y, altitude, battery, INITIAL_REPUTATION, bandwidth);
        uint16 place = zone == 0 ? 0 : _enter(zone, uint24(index));
        if (zone != 0) emit UAVZoneUpdated(msg.sender, 0, zone);
        _uavs[msg.sender] = UAV({
            x: x,
            y: y,
            altitude: altitude,
            battery: battery,
            reputation: INITIAL_REPUTATION,
            bandwidth: bandwidth,
            zone: zone,
            timestamp: uint40(block.timestamp),
            place: place,
            index: uint24(index)
        });
    }

    /// @inheritdoc ISkyRelay
    function registerVehicle(int32 x, int32 y, uint32 payment, uint32 zone) external {
        _requireNewMember();
        _requireAtMost(payment, MAX_PAYMENT);
        _vehicles[msg.sender] = Vehicle({
            x: x,
            y: y,
            payment: payment,
            reputation: INITIAL_REPUTATION,
            zone: zone,
            timestamp: uint40(block.timestamp),
            uav: 0,
            session: 0,
            proposal: 0
        });
        emit VehicleRegistered(msg.sender, x, y, payment, INITIAL_REPUTATION, zone);
    }

    /// @inheritdoc ISkyRelay
    function updateVehicleInfo(int32 x, int32 y, uint32 payment, uint32 zone) external {
        Vehicle memory v = _vehicle(msg.sender);
        _requireAtMost(payment, MAX_PAYMENT);
        if (zone != v.zone) {
            _withdraw(v);
            v.zone = zone;
        }
        v.x = x;
        v.y = y;
        v.payment = payment;
        v.timestamp = uint40(block.timestamp);
        _vehicles[msg.sender] = v;
        emit VehicleUpdated(msg.sender, x, y, payment, zone);
    }

    /// @inheritdoc ISkyRelay
    function updateUAVInfo(int32 x, int32 y, uint16 altitude, uint16 battery, uint32 bandwidth) external {
        UAV memory u = _uav(msg.sender);
        _requireAtMost(battery, MAX_BATTERY);
        _requireAtMost(bandwidth, MAX_BANDWIDTH);
        if (battery == 0) {
            _endSession(msg.sender, u);
        } else if (bandwidth < u.bandwidth) {
            (Session memory s, bool current) = _session(u);
            if (current && bandwidth < s.committed) revert BandwidthCommitted(bandwidth, s.committed);
        }
        u.x = x;
        u.y = y;
        u.altitude = altitude;
        u.battery = battery;
        u.bandwidth = bandwidth;
        u.timestamp = uint40(block.timestamp);
        _uavs[msg.sender] = u;
        emit UAVUpdated(msg.sender, x, y, altitude, battery, bandwidth);
    }

    /// @inheritdoc ISkyRelay
    function updateUAVZone(address uav, uint32 zone) external {
        UAV memory u = _uav(uav);
        if (msg.sender != uav) revert NotOwnRecord(uav, msg.sender);
        uint32 from = u.zone;
        if (zone == from) revert SameZone(zone);
        _endSession(uav, u);
        if (from != 0) _leave(from, u.place);
        u.place = zone == 0 ? 0 : _enter(zone, u.index);
        u.zone = zone;
        u.timestamp = uint40(block.timestamp);
        _uavs[uav] = u;
        emit UAVZoneUpdated(uav, from, zone);
    }

    // Selection

    /// @inheritdoc ISkyRelay
    function submitVehSelection(address uav, uint32 demand, uint32 round) external {
        Vehicle memory v = _vehicle(msg.sender);
        UAV memory u = _uav(uav);
        if (v.zone == 0 || v.zone != u.zone) revert DifferentZone(v.zone, u.zone);
        Zone memory z = _zones[u.zone];
        if (z.allocating) revert ZoneAllocating(u.zone);
        if (round != z.round) revert WrongRound(round, z.round);
        if (u.battery == 0) revert UAVEmpty(uav);
        if (demand == 0 || demand > MAX_DEMAND) revert OutOfRange(demand, MAX_DEMAND);
        (ProposalStatus status,) = _status(v, z.period);
        if (status == ProposalStatus.Pending) revert ProposalOpen(msg.sender);
        if (status == ProposalStatus.Selected) revert AlreadySelected(msg.sender);
        if (status == ProposalStatus.Rejected && v.uav == u.index) revert AlreadyRejected(msg.sender, uav);
        (uint256 qov, uint256 score, uint256 distance) = _quality(v, u, demand);
        if (RANGE_GATE && distance > MAX_DISTANCE) revert TooFar(distance, MAX_DISTANCE);

        Session memory s = _sessions[u.index];
        if (s.zone != u.zone || s.period != z.period) {
            if (s.count != 0) s = _next(s);
            s.zone = u.zone;
            s.period = z.period;
        }
        uint16 index = s.count;
        if (index == MAX_PROPOSALS) revert ProposalListFull(uav);
        s.count = index + 1;
        _sessions[u.index] = s;
        _lists[u.index][s.number & 1].proposals[index] =
            Proposal({vehicle: msg.sender, demand: demand, score: uint64(score)});
        v.uav = u.index;
        v.session = s.number;
        v.proposal = index;
        _vehicles[msg.sender] = v;
        emit VehSelectionSubmitted(
            msg.sender, uav, u.zone, round, s.number, index, demand, uint64(qov), uint64(score)
        );
    }

    /// @inheritdoc ISkyRelay
    function allocateZone(uint32 zone, uint256 maxProposals) external onlyRole(COORDINATOR_ROLE) returns (bool done) {
        Zone memory z = _zone(zone);
        if (maxProposals == 0) revert NoWork();
        uint24[] storage list = _zoneUAVs[zone];
        uint256 length = list.length;
        uint256 cursor = z.cursor;
        uint256 work = 0;
        for (; cursor < length; ++cursor) {
            uint256 index = list[cursor];
            Session memory s = _sessions[index];
            bool undecided = s.zone == zone && s.period == z.period && s.decided < s.count;
            uint256 cost = undecided ? uint256(s.count) - s.decided + s.selected : 1;
            if (work != 0 && work + cost > maxProposals) break;
            work += cost;
            if (undecided) _allocateUAV(zone, z, index, s);
        }
        done = cursor == length;
        z.allocating = !done;
        if (done) {
            emit ZoneAllocated(zone, z.period, z.round, z.selectedUAVs, z.selectedVehicles);
            z.cursor = 0;
            ++z.round;
        } else {
            z.cursor = uint16(cursor);
        }
        _zones[zone] = z;
    }

    /// @inheritdoc ISkyRelay
    function resetListsForZone(uint32 zone) external onlyRole(COORDINATOR_ROLE) {
        Zone memory z = _zone(zone);
        ++z.period;
        ++z.round;
        z.cursor = 0;
        z.allocating = false;
        z.hasModel = false;
        z.selectedUAVs = 0;
        z.selectedVehicles = 0;
        _zones[zone] = z;
        emit ZoneListsReset(zone, z.period, z.round);
    }

    /// @inheritdoc ISkyRelay
    function resetUAVSubmission(address uav) external {
        UAV memory u = _uav(uav);
        if (msg.sender != uav) _checkRole(COORDINATOR_ROLE);
        _endSession(uav, u);
    }

    // Models

    /// @inheritdoc ISkyRelay
    function registerModel(bytes calldata cid, ModelCard calldata card)
        external
        onlyRole(PUBLISHER_ROLE)
        returns (bytes32 modelId)
    {
        if (cid.length != 36 || cid[0] != 0x01 || cid[2] != 0x12 || cid[3] != 0x20) revert InvalidCID(cid);
        if (
            (OBSERVATION_SIDE != 0 && card.observationSide != OBSERVATION_SIDE) || card.channels != CHANNELS
                || card.actions != ACTIONS
        ) revert ModelDoesNotFit(card.observationSide, card.channels, card.actions);
        if (
            card.minUAVs == 0 || card.minUAVs > card.maxUAVs || card.minVehicles > card.maxVehicles
                || card.observationSide % 2 == 0
        ) revert InvalidCard();
        modelId = keccak256(abi.encode(cid, card));
        if (_models[modelId].owner != address(0)) revert ModelAlreadyRegistered(modelId);
        if (_modelList.length == MAX_MODELS) revert TooManyModels(MAX_MODELS);
        _modelList.push(modelId);
        _models[modelId] =
            Model({card: card, owner: msg.sender, codec: cid[1], retired: false, digest: bytes32(cid[4:])});
        emit ModelRegistered(modelId, msg.sender, cid, card);
    }

    /// @inheritdoc ISkyRelay
    function retireModel(bytes32 modelId) external {
        Model storage model = _model(modelId);
        if (model.retired) revert UnknownModel(modelId);
        if (msg.sender != model.owner) _checkRole(DEFAULT_ADMIN_ROLE);
        model.retired = true;
        // Later models move up one place each, so that the list keeps the order of registration.
        uint256 last = _modelList.length - 1;
        bool found = false;
        for (uint256 i = 0; i < last; ++i) {
            found = found || _modelList[i] == modelId;
            if (found) _modelList[i] = _modelList[i + 1];
        }
        _modelList.pop();
        emit ModelRetired(modelId);
    }

    /// @inheritdoc ISkyRelay
    function determineMDRLModel(uint32 zone) external onlyRole(COORDINATOR_ROLE) returns (bytes32 modelId) {
        Zone memory z = _zone(zone);
        if (z.allocating) revert ZoneAllocating(zone);
        if (z.selectedUAVs == 0) revert NothingSelected(zone);
        uint256 length = _modelList.length;
        if (length == 0) revert NoModels();
        uint256 best = type(uint256).max;
        for (uint256 i = 0; i < length; ++i) {
            bytes32 candidate = _modelList[i];
            ModelCard memory card = _models[candidate].card;
            // Lexicographic: UAVs outside the trained range, vehicles outside it, then the score, higher first.
            uint256 rank = _outside(z.selectedUAVs, card.minUAVs, card.maxUAVs) << 96
                | _outside(z.selectedVehicles, card.minVehicles, card.maxVehicles) << 64
                | uint256(int256(type(int32).max) - card.score);
            if (rank < best) {
                best = rank;
                modelId = candidate;
            }
        }
        _zoneModels[zone] = modelId;
        z.hasModel = true;
        _zones[zone] = z;
        emit ModelAssigned(zone, modelId, z.round, z.selectedUAVs, z.selectedVehicles);
    }

    // Reputation

    /// @inheritdoc ISkyRelay
    function setReputations(address[] calldata members, uint16[] calldata reputations)
        external
        onlyRole(REPUTATION_ROLE)
    {
        if (members.length != reputations.length) revert LengthMismatch(members.length, reputations.length);
        for (uint256 i = 0; i < members.length; ++i) {
            address member = members[i];
            uint16 reputation = reputations[i];
            _requireAtMost(reputation, Quality.MAX_REPUTATION);
            if (_uavs[member].timestamp != 0) _uavs[member].reputation = reputation;
            else if (_vehicle(member).timestamp != 0) _vehicles[member].reputation = reputation;
            emit ReputationSet(member, reputation);
        }
    }

    /// @inheritdoc ISkyRelay
    function rateUAV(address uav, bool good) external {
        if (RATING_STEP == 0) revert RatingsOff();
        Vehicle memory v = _vehicle(msg.sender);
        UAV memory u = _uav(uav);
        (uint32 session, uint256 decided) = _finished(u);
        if (
            v.session == 0 || v.uav != u.index || v.session != session || v.proposal >= decided
                || !_isSelected(_lists[u.index][session & 1], v.proposal)
        ) revert NotMatched(msg.sender, uav);
        _vehicles[msg.sender].session = 0; // rated: the match is used up
        uint16 reputation = _rated(u.reputation, good);
        _uavs[uav].reputation = reputation;
        emit MemberRated(uav, msg.sender, good, reputation);
    }

    /// @inheritdoc ISkyRelay
    function rateVehicle(address vehicle, uint16 index, bool good) external {
        if (RATING_STEP == 0) revert RatingsOff();
        UAV memory u = _uav(msg.sender);
        Vehicle memory v = _vehicle(vehicle);
        (uint32 session, uint256 decided) = _finished(u);
        Lists storage lists = _lists[u.index][session & 1];
        if (index >= decided || lists.proposals[index].vehicle != vehicle || !_isSelected(lists, index)) {
            revert NotMatched(vehicle, msg.sender);
        }
        delete lists.proposals[index]; // rated: the match is used up
        uint16 reputation = _rated(v.reputation, good);
        _vehicles[vehicle].reputation = reputation;
        emit MemberRated(vehicle, msg.sender, good, reputation);
    }

    // Views

    /// @inheritdoc ISkyRelay
    function getUAVInfo(address uav) external view returns (UAVInfo memory) {
        UAV memory u = _uav(uav);
        (Session memory s, bool current) = _session(u);
        return UAVInfo({
            x: u.x,
            y: u.y,
            altitude: u.altitude,
            battery: u.battery,
            reputation: u.reputation,
            bandwidth: u.bandwidth,
            available: current ? u.bandwidth - s.committed : u.bandwidth,
            zone: u.zone,
            timestamp: u.timestamp,
            index: u.index
        });
    }

    /// @inheritdoc ISkyRelay
    function getVehicleInfo(address vehicle) external view returns (VehicleInfo memory) {
        Vehicle memory v = _vehicle(vehicle);
        return VehicleInfo({
            x: v.x,
            y: v.y,
            payment: v.payment,
            reputation: v.reputation,
            zone: v.zone,
            timestamp: v.timestamp
        });
    }

    /// @inheritdoc ISkyRelay
    function getZoneUAV(uint32 zone) external view returns (address[] memory uavs) {
        _zone(zone);
        uint24[] storage list = _zoneUAVs[zone];
        uavs = new address[](list.length);
        for (uint256 i = 0; i < uavs.length; ++i) {
            uavs[i] = _uavList[list[i]];
        }
    }

    /// @inheritdoc ISkyRelay
    function getSelectedUAVs(uint32 zone) external view returns (address[] memory uavs) {
        Zone memory z = _zone(zone);
        uint24[] storage list = _zoneUAVs[zone];
        uavs = new address[](z.selectedUAVs);
        uint256 found = 0;
        for (uint256 i = 0; found < uavs.length; ++i) {
            Session memory s = _sessions[list[i]];
            if (s.zone == zone && s.period == z.period && s.selected != 0) uavs[found++] = _uavList[list[i]];
        }
    }

    /// @inheritdoc ISkyRelay
    function getZoneInfo(uint32 zone) external view returns (ZoneInfo memory) {
        Zone memory z = _zone(zone);
        return ZoneInfo({
            period: z.period,
            round: z.round,
            allocating: z.allocating,
            uavs: uint32(_zoneUAVs[zone].length),
            selectedUAVs: z.selectedUAVs,
            selectedVehicles: z.selectedVehicles,
            modelId: z.hasModel ? _zoneModels[zone] : bytes32(0)
        });
    }

    /// @inheritdoc ISkyRelay
    function getProposals(address uav) external view returns (VehicleSelection[] memory proposals) {
        UAV memory u = _uav(uav);
        (Session memory s, bool current) = _session(u);
        if (!current) return proposals;
        Lists storage lists = _lists[u.index][s.number & 1];
        proposals = new VehicleSelection[](s.count);
        for (uint256 i = 0; i < s.count; ++i) {
            Proposal memory p = lists.proposals[i];
            proposals[i] = VehicleSelection({
                vehicle: p.vehicle,
                demand: p.demand,
                score: p.score,
                status: p.vehicle == address(0) ? ProposalStatus.None : _decision(lists, s.decided, i)
            });
        }
    }

    /// @inheritdoc ISkyRelay
    function getVehicleSelection(address vehicle)
        external
        view
        returns (ProposalStatus status, address uav, uint16 index)
    {
        Vehicle memory v = _vehicle(vehicle);
        (status,) = _status(v, _zones[v.zone].period);
        if (status != ProposalStatus.None) (uav, index) = (_uavList[v.uav], v.proposal);
    }

    /// @inheritdoc ISkyRelay
    function quality(address vehicle, address uav, uint32 demand) external view returns (uint64 qov, uint64 score) {
        if (demand == 0 || demand > MAX_DEMAND) revert OutOfRange(demand, MAX_DEMAND);
        (uint256 q, uint256 s,) = _quality(_vehicle(vehicle), _uav(uav), demand);
        return (uint64(q), uint64(s));
    }

    /// @inheritdoc ISkyRelay
    function uavCount() external view returns (uint256) {
        return _uavList.length;
    }

    /// @inheritdoc ISkyRelay
    function uavAt(uint256 index) external view returns (address) {
        return _uavList[index];
    }

    /// @inheritdoc ISkyRelay
    function modelCount() external view returns (uint256) {
        return _modelList.length;
    }

    /// @inheritdoc ISkyRelay
    function modelAt(uint256 index) external view returns (bytes32) {
        return _modelList[index];
    }

    /// @inheritdoc ISkyRelay
    function getModel(bytes32 modelId)
        external
        view
        returns (bytes memory cid, ModelCard memory card, address owner, bool retired)
    {
        Model storage model = _model(modelId);
        cid = abi.encodePacked(bytes1(0x01), model.codec, bytes2(0x1220), model.digest);
        return (cid, model.card, model.owner, model.retired);
    }

    // Allocation

    /// @dev Algorithm 2 for one UAV: what it holds and what is new, together, against its whole bandwidth.
    function _allocateUAV(uint32 zone, Zone memory z, uint256 index, Session memory s) private {
        address uav = _uavList[index];
        Lists storage lists = _lists[index][s.number & 1];
        uint256 size = uint256(s.count) - s.decided + s.selected;
        address[] memory vehicles = new address[](size);
        uint256[] memory heap = new uint256[](size);
        uint256 least = type(uint32).max;
        size = 0;
        for (uint256 i = 0; i < s.count; ++i) {
            if (i < s.decided && !_isSelected(lists, i)) continue;
            Proposal memory p = lists.proposals[i];
            if (p.vehicle == address(0)) continue; // withdrawn
            vehicles[size] = p.vehicle;
            // The larger word is the better one: by score, then by the earlier submission. Below: place and demand.
            heap[size] = uint256(p.score) << 192 | (type(uint16).max - i) << 176 | size << 32 | p.demand;
            if (p.demand < least) least = p.demand;
            ++size;
        }
        assembly ("memory-safe") {
            mstore(heap, size) // withdrawn proposals left room
        }

        uint256[MAX_PROPOSALS / 256] memory selected;
        uint256 taken = 0;
        uint256 left = _uavs[uav].bandwidth;
        ProposalHeap.build(heap);
        // Once less is left than the least that anyone asks for, all others are rejected.
        for (; size != 0 && least <= left; --size) {
            uint256 best = ProposalHeap.pop(heap, size);
            uint256 demand = uint32(best);
            if (demand > left) continue;
            left -= demand;
            uint256 i = type(uint16).max - uint16(best >> 176);
            selected[i >> 8] |= 1 << (i & 0xff);
            // Those taken so far have left the heap's tail free.
            heap[heap.length - 1 - taken++] = uint16(best >> 32);
        }
        for (uint256 w = 0; w << 8 < s.count; ++w) {
            lists.selected[w] = selected[w];
        }
        address[] memory names = new address[](taken);
        for (uint256 i = 0; i < taken; ++i) {
            names[i] = vehicles[heap[heap.length - 1 - i]];
        }

        z.selectedVehicles = z.selectedVehicles - s.selected + uint32(taken);
        if (s.selected == 0 && taken != 0) ++z.selectedUAVs;
        if (s.selected != 0 && taken == 0) --z.selectedUAVs;
        s.decided = s.count;
        s.selected = uint16(taken);
        s.committed = uint32(_uavs[uav].bandwidth - left);
        _sessions[index] = s;
        emit UAVAllocated(uav, zone, z.round, s.number, s.decided, s.committed, names);
    }

    // Sessions

    /// @dev The session of a UAV, and whether it belongs to the current period of the UAV's zone.
    function _session(UAV memory u) private view returns (Session memory s, bool current) {
        s = _sessions[u.index];
        current = s.count != 0 && s.zone == u.zone && s.period == _zones[u.zone].period;
    }

    function _next(Session memory s) private pure returns (Session memory) {
        return Session({
            number: s.number + 1,
            zone: 0,
            period: 0,
            count: 0,
            decided: 0,
            selected: 0,
            committed: 0,
            decidedBefore: s.decided
        });
    }

    /// @dev Void a UAV's proposals and selections: their vehicles are free at once, without being written.
    function _endSession(address uav, UAV memory u) private {
        (Session memory s, bool current) = _session(u);
        if (s.count == 0) return;
        if (current && s.selected != 0) {
            Zone storage z = _zones[u.zone];
            --z.selectedUAVs;
            z.selectedVehicles -= s.selected;
        }
        _sessions[u.index] = _next(s);
        emit UAVSubmissionReset(uav, s.number + 1);
    }

    /// @dev Take the caller's open or selected proposal, if it has one, from its UAV's list.
    function _withdraw(Vehicle memory v) private {
        Zone storage z = _zones[v.zone];
        (ProposalStatus status, Session memory s) = _status(v, z.period);
        if (status != ProposalStatus.Pending && status != ProposalStatus.Selected) return;
        Lists storage lists = _lists[v.uav][s.number & 1];
        if (status == ProposalStatus.Selected) {
            lists.selected[v.proposal >> 8] &= ~(1 << (v.proposal & 0xff));
            s.committed -= lists.proposals[v.proposal].demand;
            if (--s.selected == 0) --z.selectedUAVs;
            --z.selectedVehicles;
            _sessions[v.uav] = s;
        }
        delete lists.proposals[v.proposal];
        emit VehSelectionWithdrawn(msg.sender, _uavList[v.uav], v.session, v.proposal);
        v.session = 0;
    }

    /// @dev Where a vehicle's latest proposal stands in `period` of its zone, and the session it is in.
    function _status(Vehicle memory v, uint32 period) private view returns (ProposalStatus, Session memory s) {
        if (v.session == 0) return (ProposalStatus.None, s);
        s = _sessions[v.uav];
        if (s.number != v.session || s.zone != v.zone || s.period != period) return (ProposalStatus.None, s);
        return (_decision(_lists[v.uav][s.number & 1], s.decided, v.proposal), s);
    }

    function _decision(Lists storage lists, uint256 decided, uint256 i) private view returns (ProposalStatus) {
        if (i >= decided) return ProposalStatus.Pending;
        return _isSelected(lists, i) ? ProposalStatus.Selected : ProposalStatus.Rejected;
    }

    function _isSelected(Lists storage lists, uint256 i) private view returns (bool) {
        return lists.selected[i >> 8] >> (i & 0xff) & 1 != 0;
    }

    // Ratings

    /// @dev The last session of a UAV that is over, and how many of its proposals were decided.
    function _finished(UAV memory u) private view returns (uint32 number, uint256 decided) {
        (Session memory s, bool current) = _session(u);
        return current || s.count == 0 ? (s.number - 1, s.decidedBefore) : (s.number, s.decided);
    }

    function _rated(uint16 reputation, bool good) private view returns (uint16) {
        if (good) {
            uint256 raised = uint256(reputation) + RATING_STEP;
            return uint16(raised > Quality.MAX_REPUTATION ? Quality.MAX_REPUTATION : raised);
        }
        return reputation > RATING_STEP ? reputation - RATING_STEP : 0;
    }

    // Zones

    function _enter(uint32 zone, uint24 index) private returns (uint16 place) {
        Zone storage z = _zones[zone];
        if (z.period == 0) {
            z.period = 1;
            z.round = 1;
            emit ZoneOpened(zone);
        }
        uint24[] storage list = _zoneUAVs[zone];
        uint256 length = list.length;
        _requireAtMost(length, type(uint16).max - 1);
        list.push(index);
        return uint16(length);
    }

    /// @dev Fill the gap with the last UAV; during an allocation by way of the last decided one, so that the places
    /// below the cursor stay the decided ones.
    function _leave(uint32 zone, uint256 gap) private {
        Zone storage z = _zones[zone];
        uint24[] storage list = _zoneUAVs[zone];
        uint256 cursor = z.cursor;
        if (gap < cursor) {
            --cursor;
            z.cursor = uint16(cursor);
            _move(list, cursor, gap);
            gap = cursor;
        }
        _move(list, list.length - 1, gap);
        list.pop();
    }

    function _move(uint24[] storage list, uint256 from, uint256 to) private {
        if (from == to) return;
        uint24 index = list[from];
        list[to] = index;
        _uavs[_uavList[index]].place = uint16(to);
    }

    // Arithmetic

    function _quality(Vehicle memory v, UAV memory u, uint256 demand)
        private
        view
        returns (uint256 qov, uint256 score, uint256 distance)
    {
        distance = Quality.distance(int256(v.x) - u.x, int256(v.y) - u.y);
        uint256 closeness = distance < MAX_DISTANCE ? MAX_DISTANCE - distance : 0;
        unchecked {
            // Each term is below 2^218: see Quality.coefficients.
            qov = (
                DEMAND_COEFFICIENT * demand + PAYMENT_COEFFICIENT * v.payment + REPUTATION_COEFFICIENT * v.reputation
                    + CLOSENESS_COEFFICIENT * closeness
            ) / DENOMINATOR;
        }
        score = Quality.score(qov, demand);
    }

    function _outside(uint256 value, uint256 low, uint256 high) private pure returns (uint256) {
        if (value < low) return low - value;
        return value > high ? value - high : 0;
    }

    // Records: what is unknown reverts

    function _requireNewMember() private view {
        if (_uavs[msg.sender].timestamp != 0 || _vehicles[msg.sender].timestamp != 0) {
            revert AlreadyRegistered(msg.sender);
        }
    }

    function _requireAtMost(uint256 value, uint256 maximum) private pure {
        if (value > maximum) revert OutOfRange(value, maximum);
    }

    function _uav(address uav) private view returns (UAV memory u) {
        u = _uavs[uav];
        if (u.timestamp == 0) revert UnknownUAV(uav);
    }

    function _vehicle(address vehicle) private view returns (Vehicle memory v) {
        v = _vehicles[vehicle];
        if (v.timestamp == 0) revert UnknownVehicle(vehicle);
    }

    function _zone(uint32 zone) private view returns (Zone memory z) {
        z = _zones[zone];
        if (z.period == 0) revert UnknownZone(zone);
    }

    function _model(bytes32 modelId) private view returns (Model storage model) {
        model = _models[modelId];
        if (model.owner == address(0)) revert UnknownModel(modelId);
    }
}
