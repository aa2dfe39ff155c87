// SPDX-License-Identifier: Apache-2.0
pragma solidity 0.8.26;

import {AccessControlDefaultAdminRules} from
    "@openzeppelin/contracts/access/extensions/AccessControlDefaultAdminRules.sol";
import {ECDSA} from "@openzeppelin/contracts/utils/cryptography/ECDSA.sol";
import {MessageHashUtils} from "@openzeppelin/contracts/utils/cryptography/MessageHashUtils.sol";
import {Math} from "@openzeppelin/contracts/utils/math/Math.sol";
import {SkyRelayBase} from "./SkyRelayBase.sol";
import {ISkyRelayExtension} from "./interfaces/ISkyRelayExtension.sol";
import {ProposalHeap} from "./libraries/ProposalHeap.sol";
import {Member, MemberLibrary, Past, Proposal, Session, Zone} from "./libraries/Records.sol";

/// @title The extension of SkyRelay: what the consortium calls, and views; ISkyRelayExtension says what each function does
/// @notice Runs on SkyRelay's storage, by its fallback. Called at its own address it knows nobody, and its administrator
/// is itself: whatever writes reverts.
contract SkyRelayExtension is SkyRelayBase, AccessControlDefaultAdminRules, ISkyRelayExtension {
    /// @notice Runs allocations and resets, assigns models, in zones without a coordinator of their own.
    bytes32 public constant COORDINATOR_ROLE = keccak256("COORDINATOR_ROLE");
    /// @notice Registers models.
    bytes32 public constant PUBLISHER_ROLE = keccak256("PUBLISHER_ROLE");
    /// @notice Sets reputations.
    bytes32 public constant REPUTATION_ROLE = keccak256("REPUTATION_ROLE");
    /// @notice Admits members by vouchers, suspends members and zones.
    bytes32 public constant REGISTRAR_ROLE = keccak256("REGISTRAR_ROLE");
    /// @notice Has zones decided by claims: the contract OptimisticSelection, where a consortium has one.
    bytes32 public constant SETTLER_ROLE = keccak256("SETTLER_ROLE");

    /// @dev Models in use: what bounds the gas of `determineMDRLModel`.
    uint256 private constant MAX_MODELS = 64;
    bytes32 private constant VOUCHER = keccak256("Voucher(address member,uint8 kind,uint256 expires)");

    uint256 private immutable RATING_STEP;
    uint256 private immutable OBSERVATION_SIDE;
    uint256 private immutable CHANNELS;
    uint256 private immutable ACTIONS;
    bool private immutable ADMISSION;
    uint256 private immutable ALLOCATION_DEADLINE;
    uint256 private immutable MINIMUM_PERIOD;
    uint48 private immutable ADMIN_DELAY;
    uint256 private immutable SETTLING;

    constructor(Parameters memory p)
        SkyRelayBase(p)
        AccessControlDefaultAdminRules(0, address(this))
    {
        RATING_STEP = p.ratingStep;
        OBSERVATION_SIDE = p.observationSide;
        CHANNELS = p.channels;
        ACTIONS = p.actions;
        ADMISSION = p.admission;
        ALLOCATION_DEADLINE = p.allocationDeadline;
        MINIMUM_PERIOD = p.minimumPeriod;
        ADMIN_DELAY = p.adminDelay;
        SETTLING = p.settling;
    }

    // Administration

    /// @inheritdoc ISkyRelayExtension
    function initialise(address administrator) external {
        // Whoever runs this code without having any is SkyRelay's constructor.
        if (address(this).code.length != 0) revert InvalidParameters();
        _grantRole(DEFAULT_ADMIN_ROLE, administrator);
    }

    /// @notice How long a change of the administrator takes at the least [s], as deployed.
    function defaultAdminDelay() public view override returns (uint48) {
        return ADMIN_DELAY;
    }

    function _changeDefaultAdminDelay(uint48) internal pure override {
        revert AdminDelayFixed();
    }

    /// @inheritdoc ISkyRelayExtension
    function setZoneCoordinator(uint32 zone, address coordinator) external onlyRole(DEFAULT_ADMIN_ROLE) {
        _coordinators[zone] = coordinator;
        emit ZoneCoordinatorSet(zone, coordinator);
    }

    // Admission

    /// @inheritdoc ISkyRelayExtension
    function admit(address member, uint8 kind, uint256 expires, bytes calldata signature) external {
        if (!ADMISSION) revert AdmissionOpen();
        if (Member.unwrap(_members[member]) != 0) revert AlreadyRegistered(member);
        bytes32 hash = keccak256(abi.encode(VOUCHER, member, kind, expires));
        address registrar =
            ECDSA.recover(MessageHashUtils.toTypedDataHash(_domain(address(this)), hash), signature);
        if (
            !hasRole(REGISTRAR_ROLE, registrar) || block.timestamp > expires
                || (kind != MemberLibrary.UAV && kind != MemberLibrary.VEHICLE)
        ) revert InvalidVoucher();
        _members[member] = Member.wrap((kind | MemberLibrary.ADMITTED) << 160);
        emit MemberAdmitted(member, kind, registrar);
    }

    /// @inheritdoc ISkyRelayExtension
    function suspendMember(address member, bool suspended) external onlyRole(REGISTRAR_ROLE) {
        Member m = _members[member];
        if (m.kind() == MemberLibrary.VEHICLE) {
            (ProposalStatus status, Session s) = _status(m);
            if (status == ProposalStatus.Pending || status == ProposalStatus.Selected) {
                m = _withdraw(member, m, status, s);
            }
        } else if (m.kind() == MemberLibrary.UAV) {
            _endSession(member, m);
        } else {
            revert UnknownMember(member);
        }
        if (SETTLING != 0) _past[member] = _past[member].withSuspension();
        _members[member] = m.withSuspension(suspended);
        emit MemberSuspended(member, suspended);
    }

    /// @inheritdoc ISkyRelayExtension
    function suspendZone(uint32 zone, bool suspended) external onlyRole(REGISTRAR_ROLE) {
        _zones[zone] = _zone(zone).withSuspension(suspended);
        emit ZoneSuspended(zone, suspended);
    }

    // Selection

    /// @inheritdoc ISkyRelayExtension
    function submitSigned(SignedBatch[] calldata batches) external returns (uint256 taken) {
        bytes32 domain = _domain(address(this));
        for (uint256 b = 0; b < batches.length; ++b) {
            address uav = batches[b].uav;
            SignedProposal[] calldata proposals = batches[b].proposals;
            Member u = _uav(uav);
            uint256 round = _zones[u.uavZone()].round();
            for (uint256 i = 0; i < proposals.length; ++i) {
                if (_proposeSigned(domain, uav, u, round, proposals[i])) ++taken;
            }
        }
    }

    /// @inheritdoc ISkyRelayExtension
    function allocateZone(uint32 zone, uint256 maxProposals) external returns (bool done) {
        Zone z = _zone(zone);
        if (!z.allocating() && !(z.waiting() && _isOverdue(z))) _requireCoordinator(zone, msg.sender);
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
        } else {
            emit ZonePieceAllocated(zone, uint32(z.round()), uint16(cursor));
        }
        _zones[zone] = done ? z.nextRound() : z.paused(cursor);
    }

    /// @inheritdoc ISkyRelayExtension
    function resetListsForZone(uint32 zone) external {
        Zone z = _zone(zone);
        uint256 due = z.begun() + MINIMUM_PERIOD;
        if (MINIMUM_PERIOD == 0 || block.timestamp <= due || !_isOverdue(z)) _requireCoordinator(zone, msg.sender);
        if (z.allocating() || z.waiting()) revert ProposalsUndecided(zone);
        if (block.timestamp < due) revert PeriodNotDue(zone, due);
        z = z.nextPeriod();
        _zones[zone] = z;
        emit ZoneListsReset(zone, uint32(z.period()), uint32(z.round()));
    }

    /// @inheritdoc ISkyRelayExtension
    function determineMDRLModel(uint32 zone) external returns (bytes32 modelId) {
        Zone z = _zone(zone);
        if (z.hasModel() || z.waiting() || !_isOverdue(z)) _requireCoordinator(zone, msg.sender);
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

    // Claims

    /// @inheritdoc ISkyRelayExtension
    function settle(uint32 zone, uint32 round, address coordinator, int256 uavs, int256 vehicles)
        external
        onlyRole(SETTLER_ROLE)
        returns (uint32 period)
    {
        Zone z = _zone(zone);
        _requireCoordinator(zone, coordinator);
        if (z.suspended()) revert SuspendedZone(zone);
        if (round != z.round()) revert WrongRound(round, uint32(z.round()));
        if (z.allocating() || z.waiting()) revert ProposalsUndecided(zone);
        if (!z.claimed() && z.selectedUAVs() != 0) revert ZoneDecided(zone);
        uint256 allUAVs = uint256(uavs + int256(z.selectedUAVs()));
        uint256 allVehicles = uint256(vehicles + int256(z.selectedVehicles()));
        _requireAtMost(allUAVs, MAX_ZONE_UAVS); // below 0 is above all
        _requireAtMost(allVehicles, type(uint32).max);
        z = z.withClaim(allUAVs, allVehicles);
        period = uint32(z.period());
        emit ZoneAllocated(zone, period, round, uint32(allUAVs), uint32(allVehicles));
        _zones[zone] = z.nextRound();
    }

    /// @inheritdoc ISkyRelayExtension
    function unsettle(uint32 zone, uint32 period) external onlyRole(SETTLER_ROLE) {
        Zone z = _zones[zone];
        if (z.period() != period) return;
        _zones[zone] = z.withoutClaim();
        emit ZoneUnsettled(zone, period);
    }

    /// @inheritdoc ISkyRelayExtension
    function recordsAt(address[] calldata members, uint256 number) external view returns (Member[] memory records) {
        records = new Member[](members.length);
        for (uint256 i = 0; i < members.length; ++i) {
            Member m = _members[members[i]];
            if (number < block.number) {
                Past past = _past[members[i]];
                if (past.rated() > number) m = m.withReputation(past.reputation());
                if (past.suspended() > number) m = m.withSuspension(false);
            }
            records[i] = m;
        }
    }

    // Models

    /// @inheritdoc ISkyRelayExtension
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
                || card.observationSide % 2 == 0 || card.score > 0
        ) revert InvalidCard();
        // With its owner, so that nobody can take another's id first, and retire it for ever.
        modelId = keccak256(abi.encode(msg.sender, cid, card));
        if (_models[modelId].owner != address(0)) revert ModelAlreadyRegistered(modelId);
        if (_modelList.length == MAX_MODELS) revert TooManyModels(MAX_MODELS);
        _modelList.push(modelId);
        _models[modelId] =
            Model({card: card, owner: msg.sender, codec: cid[1], retired: false, digest: bytes32(cid[4:])});
        emit ModelRegistered(modelId, msg.sender, cid, card);
    }

    /// @inheritdoc ISkyRelayExtension
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

    // Reputation

    /// @inheritdoc ISkyRelayExtension
    function setReputations(address[] calldata members, uint16[] calldata reputations)
        external
        onlyRole(REPUTATION_ROLE)
    {
        if (members.length != reputations.length) revert LengthMismatch(members.length, reputations.length);
        for (uint256 i = 0; i < members.length; ++i) {
            address member = members[i];
            uint16 reputation = reputations[i];
            _requireAtMost(reputation, HUNDRED);
            Member m = _members[member];
            if (m.kind() != MemberLibrary.UAV && m.kind() != MemberLibrary.VEHICLE) revert UnknownMember(member);
            _setReputation(member, m, reputation);
            emit ReputationSet(member, reputation);
        }
    }

    /// @inheritdoc ISkyRelayExtension
    function rateUAV(address uav, bool good) external {
        Member v = _vehicle(msg.sender);
        Member u = _uav(uav);
        (uint256 session,, bool selected) = _match(u, v.proposedIndex(), msg.sender, uav);
        if (!selected || v.proposedUAV() != u.index() || v.proposedSession() != session) {
            revert NotMatched(msg.sender, uav);
        }
        _members[msg.sender] = v.withProposal(0, 0, 0); // the match is used up
        _rate(uav, u, good);
    }

    /// @inheritdoc ISkyRelayExtension
    function rateVehicle(address vehicle, uint16 index, bool good) external {
        Member u = _uav(msg.sender);
        Member v = _vehicle(vehicle);
        (, Lists storage lists, bool selected) = _match(u, index, vehicle, msg.sender);
        Proposal[MAX_PLACES] storage proposals = lists.proposals;
        Proposal p = proposals[index];
        // One without demand was selected and given up.
        if (p.vehicle() != vehicle || (!selected && p.demand() != 0)) revert NotMatched(vehicle, msg.sender);
        proposals[index] = Proposal.wrap(0); // the match is used up
        _rate(vehicle, v, good);
    }

    // Views

    /// @inheritdoc ISkyRelayExtension
    function getZoneUAV(uint32 zone, uint256 first, uint256 most) public view returns (address[] memory uavs) {
        uint256 length = _zone(zone).uavs();
        uavs = new address[](first < length ? Math.min(most, length - first) : 0);
        uint24[MAX_ZONE_UAVS] storage list = _zoneUAVs[zone];
        for (uint256 i = 0; i < uavs.length; ++i) {
            uavs[i] = _uavList[list[first + i]];
        }
    }

    /// @inheritdoc ISkyRelayExtension
    function getUAVInfo(address uav) external view returns (UAVInfo memory) {
        Member u = _uav(uav);
        (Session s, bool current) = _session(u);
        return UAVInfo({
            x: int32(u.x()),
            y: int32(u.y()),
            altitude: uint16(u.altitude()),
            battery: uint16(u.battery()),
            reputation: uint16(u.reputation()),
            bandwidth: uint32(u.bandwidth()),
            available: uint32(current ? u.bandwidth() - s.committed() : u.bandwidth()),
            zone: uint32(u.uavZone()),
            timestamp: uint40(u.timestamp()),
            index: uint24(u.index())
        });
    }

    /// @inheritdoc ISkyRelayExtension
    function quality(address vehicle, address uav, uint32 demand) external view returns (uint64 qov, uint64 score) {
        (uint256 q, uint256 s,) = _quality(_vehicle(vehicle), _uav(uav), demand);
        return (uint64(q), uint64(s));
    }

    /// @inheritdoc ISkyRelayExtension
    function getVehicleInfo(address vehicle) external view returns (VehicleInfo memory) {
        Member v = _vehicle(vehicle);
        return VehicleInfo({
            x: int32(v.x()),
            y: int32(v.y()),
            payment: uint32(v.payment()),
            reputation: uint16(v.reputation()),
            zone: uint32(v.vehicleZone()),
            timestamp: uint40(v.timestamp())
        });
    }

    /// @inheritdoc ISkyRelayExtension
    function getSelectedUAVs(uint32 zone, uint256 first, uint256 most)
        external
        view
        returns (address[] memory uavs)
    {
        address[] memory found = getZoneUAV(zone, first, most);
        uint256 count = 0;
        for (uint256 i = 0; i < found.length; ++i) {
            (Session s, bool current) = _session(_members[found[i]]);
            if (current && s.selected() != 0) found[count++] = found[i];
        }
        uavs = new address[](count);
        for (uint256 i = 0; i < count; ++i) {
            uavs[i] = found[i];
        }
    }

    /// @inheritdoc ISkyRelayExtension
    function getZoneInfo(uint32 zone) external view returns (ZoneInfo memory) {
        Zone z = _zone(zone);
        return ZoneInfo({
            period: uint32(z.period()),
            round: uint32(z.round()),
            allocating: z.allocating(),
            waiting: z.waiting(),
            suspended: z.suspended(),
            since: uint32(z.since()),
            begun: uint32(z.begun()),
            coordinator: _coordinators[zone],
            uavs: uint32(z.uavs()),
            selectedUAVs: uint32(z.selectedUAVs()),
            selectedVehicles: uint32(z.selectedVehicles()),
            modelId: z.hasModel() ? _zoneModels[zone] : bytes32(0)
        });
    }

    /// @inheritdoc ISkyRelayExtension
    function getProposals(address uav) external view returns (VehicleSelection[] memory proposals) {
        Member u = _uav(uav);
        (Session s, bool current) = _session(u);
        proposals = new VehicleSelection[](current ? s.count() : 0);
        Lists storage lists = _lists[u.index()][s.list()];
        for (uint256 i = 0; i < proposals.length; ++i) {
            Proposal p = lists.proposals[i];
            proposals[i] = VehicleSelection({
                vehicle: p.vehicle(),
                demand: uint32(p.demand()),
                score: uint64(p.score()),
                status: p.demand() == 0 ? ProposalStatus.None : _decision(lists, s.decided(), i)
            });
        }
    }

    /// @inheritdoc ISkyRelayExtension
    function getVehicleSelection(address vehicle)
        external
        view
        returns (ProposalStatus status, address uav, uint16 index)
    {
        Member v = _vehicle(vehicle);
        (status,) = _status(v);
        if (status != ProposalStatus.None) (uav, index) = (_uavList[v.proposedUAV()], uint16(v.proposedIndex()));
    }

    /// @inheritdoc ISkyRelayExtension
    function uavCount() external view returns (uint256) {
        return _uavList.length;
    }

    /// @inheritdoc ISkyRelayExtension
    function uavAt(uint256 index) external view returns (address) {
        return _uavList[index];
    }

    /// @inheritdoc ISkyRelayExtension
    function modelCount() external view returns (uint256) {
        return _modelList.length;
    }

    /// @inheritdoc ISkyRelayExtension
    function modelAt(uint256 index) external view returns (bytes32) {
        return _modelList[index];
    }

    /// @inheritdoc ISkyRelayExtension
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
    function _allocateUAV(uint256 zone, Zone z, uint256 index, Session s) private returns (Zone) {
        address uav = _uavList[index];
        uint256 bandwidth = _members[uav].bandwidth();
        Lists storage lists = _lists[index][s.list()];
        (uint256[] memory heap, address[] memory vehicles) = _load(lists, s);
        uint256[] memory bits = new uint256[]((s.count() + 255) >> 8);
        (uint256 taken, uint256 left) = ProposalHeap.take(heap, bits, bandwidth);
        address[] memory selected = new address[](taken);
        for (uint256 i = 0; i < taken; ++i) {
            selected[i] = vehicles[heap[heap.length - 1 - i]];
        }
        for (uint256 w = 0; w < bits.length; ++w) {
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
    /// @return heap a word each, the larger the better: score, then the earlier place; below number and demand.
    /// @return vehicles by number.
    function _load(Lists storage lists, Session s)
        private
        view
        returns (uint256[] memory heap, address[] memory vehicles)
    {
        uint256 count = s.count();
        uint256 decided = s.decided();
        heap = new uint256[](count - decided + s.selected());
        vehicles = new address[](heap.length);
        uint256 size = 0;
        unchecked {
            for (uint256 w = 0; w << 8 < decided; ++w) {
                uint256 word = lists.selected[w];
                while (word != 0) {
                    uint256 bit = word & (~word + 1);
                    word ^= bit;
                    uint256 i = w << 8 | Math.log2(bit);
                    Proposal p = lists.proposals[i];
                    (vehicles[size], heap[size]) = (p.vehicle(), ProposalHeap.word(p.score(), i, size, p.demand()));
                    ++size;
                }
            }
            for (uint256 i = decided; i < count; ++i) {
                Proposal p = lists.proposals[i];
                (vehicles[size], heap[size]) = (p.vehicle(), ProposalHeap.word(p.score(), i, size, p.demand()));
                ++size;
            }
        }
    }

    /// @dev Revert unless an account coordinates the zone.
    function _requireCoordinator(uint32 zone, address account) private view {
        address coordinator = _coordinators[zone];
        if (coordinator == address(0)) _checkRole(COORDINATOR_ROLE, account);
        else if (coordinator != account) revert NotCoordinator(zone, account);
    }

    /// @dev The coordinator has had its time: what takes no choice is anyone's.
    function _isOverdue(Zone z) private view returns (bool) {
        return block.timestamp > z.since() + ALLOCATION_DEADLINE;
    }

    /// @dev Take one proposal by its signature; false where it is another round's, nobody's, or refused.
    function _proposeSigned(bytes32 domain, address uav, Member u, uint256 round, SignedProposal calldata signed)
        private
        returns (bool)
    {
        uint256 terms = signed.terms;
        (int32 x, int32 y) = (int32(uint32(terms)), int32(uint32(terms >> 32)));
        (uint256 payment, uint256 demand, uint256 since) =
            (uint32(terms >> 64), uint32(terms >> 96), uint32(terms >> 128));
        bytes32 hash = _proposalHash(uav, u.uavZone(), round, terms);
        // slither-disable-next-line unused-return (why a signature is none does not matter)
        (address vehicle, ECDSA.RecoverError failure,) =
            ECDSA.tryRecover(MessageHashUtils.toTypedDataHash(domain, hash), signed.r, signed.vs);
        Member v = _members[vehicle];
        if (
            failure != ECDSA.RecoverError.NoError || v.kind() != MemberLibrary.VEHICLE || v.timestamp() != since
                || payment > MAX_PAYMENT
        ) return false;
        (ProposalStatus status,) = _status(v);
        bool moves = v.vehicleZone() != u.uavZone();
        v = v.withInfo(MemberLibrary.vehicleInfo(x, y, payment, u.uavZone(), v));
        // One that comes back to a zone comes back to what was decided there.
        if (moves && status == ProposalStatus.None) (status,) = _status(v);
        return _propose(vehicle, v, status, uav, u, demand, round).length == 0;
    }

    // Ratings

    /// @dev Of the UAV's last finished session that served somebody: number, lists, and whether its proposal `i` was
    /// selected; reverts where it had no such proposal.
    function _match(Member u, uint256 i, address vehicle, address uav)
        private
        view
        returns (uint256 session, Lists storage lists, bool selected)
    {
        if (RATING_STEP == 0) revert RatingsOff();
        (Session s, bool current) = _session(u);
        bool finished = !current && s.served();
        session = finished ? s.number() : s.numberBefore();
        lists = _lists[u.index()][finished ? s.list() : 1 - s.list()];
        uint256 decided = finished ? s.decided() : s.decidedBefore();
        if (i >= decided) revert NotMatched(vehicle, uav);
        selected = _isSelected(lists, i);
    }

    function _rate(address member, Member m, bool good) private {
        uint256 reputation = m.reputation();
        if (good) reputation = Math.min(reputation + RATING_STEP, HUNDRED);
        else reputation = Math.saturatingSub(reputation, RATING_STEP);
        _setReputation(member, m, reputation);
        emit MemberRated(member, msg.sender, good, uint16(reputation));
    }

    // Records

    /// @dev Where claims are taken, what a reputation was stays known until nobody can question a claim that used it.
    function _setReputation(address member, Member m, uint256 reputation) private {
        if (SETTLING != 0) {
            Past past = _past[member];
            if (past.rated() != 0 && block.number <= past.rated() + SETTLING) {
                revert ReputationSettling(member);
            }
            _past[member] = past.withReputation(m.reputation());
        }
        _members[member] = m.withReputation(reputation);
    }

    function _outside(uint256 value, uint256 low, uint256 high) private pure returns (uint256) {
        if (value < low) return low - value;
        return value > high ? value - high : 0;
    }

    function _zone(uint256 zone) private view returns (Zone z) {
        z = _zones[zone];
        if (Zone.unwrap(z) == 0) revert UnknownZone(uint32(zone));
    }

    function _model(bytes32 modelId) private view returns (Model storage model) {
        model = _models[modelId];
        if (model.owner == address(0)) revert UnknownModel(modelId);
    }
}
