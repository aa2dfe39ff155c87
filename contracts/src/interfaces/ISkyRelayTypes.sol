// SPDX-License-Identifier: Apache-2.0
pragma solidity 0.8.26;

/// @title What SkyRelay stores, tells and refuses
/// @dev Units: positions and distances 0.1 m; altitude 1 m; bandwidth and demand 1 kbit/s; payment 1 cent per Mbit/s;
/// battery and reputation 0.01 (0 to 10,000); QoV 1e-15 (100 is 1e17); score 1e-17 of QoV per square root of kbit/s.
/// Zone 0 is no zone. A period of a zone starts with `resetListsForZone` and has one or more rounds; a round ends
/// when `allocateZone` has decided every proposal of the zone.
interface ISkyRelayTypes {
    /// @notice What is fixed at deployment.
    struct Parameters {
        /// Weights of Eq. 1 in 1e-6: bandwidth, battery, reputation, closeness. Published for vehicles, unused on chain.
        uint32[4] qouWeights;
        /// Weights of Eq. 2 in 1e-6: demand, payment, reputation, closeness.
        uint32[4] qovWeights;
        /// Max AB [kbit/s]. A UAV may not declare more.
        uint32 maxBandwidth;
        /// Max RB [kbit/s]. A vehicle may not ask for more.
        uint32 maxDemand;
        /// Max PayPerMbps [cents per Mbit/s]. A vehicle may not offer more.
        uint32 maxPayment;
        /// Max distance [0.1 m].
        uint32 maxDistance;
        /// True: candidates are the zone's UAVs within `maxDistance`; false: all of the zone.
        bool rangeGate;
        /// Reputation of a new member [0.01].
        uint16 initialReputation;
        /// How far one rating moves a reputation [0.01]; 0 switches ratings off.
        uint16 ratingStep;
        /// Side n of the observation that a model must have; 0: any.
        uint16 observationSide;
        /// Channels of the observation that a model must have.
        uint8 channels;
        /// Actions that a model must have.
        uint8 actions;
    }

    /// @notice Table "Data Structures", UAVInfo.
    struct UAVInfo {
        int32 x;
        int32 y;
        uint16 altitude;
        uint16 battery;
        uint16 reputation;
        /// Bandwidth that the UAV offers in a period [kbit/s].
        uint32 bandwidth;
        /// What is left of it in the current period [kbit/s].
        uint32 available;
        uint32 zone;
        /// Time of the last write [s].
        uint40 timestamp;
        /// Place in the list of all UAVs.
        uint24 index;
    }

    /// @notice Table "Data Structures", VehicleInfo.
    struct VehicleInfo {
        int32 x;
        int32 y;
        uint32 payment;
        uint16 reputation;
        uint32 zone;
        uint40 timestamp;
    }

    /// @notice Where a vehicle's latest proposal stands in its zone's current period.
    enum ProposalStatus {
        None,
        Pending,
        Selected,
        Rejected
    }

    /// @notice Table "Data Structures", VehicleSelection. A withdrawn proposal has vehicle 0.
    struct VehicleSelection {
        address vehicle;
        uint32 demand;
        uint64 score;
        ProposalStatus status;
    }

    /// @notice A zone at this moment.
    struct ZoneInfo {
        /// Counts the calls of `resetListsForZone`, from 1.
        uint32 period;
        /// Counts allocations and resets, from 1; a proposal names the round it is for.
        uint32 round;
        /// True between the first and the last piece of an allocation: no proposal is taken.
        bool allocating;
        uint32 uavs;
        uint32 selectedUAVs;
        uint32 selectedVehicles;
        /// Assigned model, or 0.
        bytes32 modelId;
    }

    /// @notice What a policy was trained for.
    struct ModelCard {
        uint16 minUAVs;
        uint16 maxUAVs;
        uint16 minVehicles;
        uint16 maxVehicles;
        /// Side n, channels and actions of the policy.
        uint16 observationSide;
        uint8 channels;
        uint8 actions;
        /// Mean greedy return per episode [0.001].
        int32 score;
    }

    /// @param extension what SkyRelay passes on to: its code is part of what must be checked.
    // slither-disable-next-line unindexed-event-address (there is one in a contract's life)
    event Deployed(Parameters parameters, address extension);

    /// @notice A member became the UAV number `index`; `UAVZoneUpdated` follows.
    event UAVRegistered(
        address indexed uav,
        uint24 index,
        int32 x,
        int32 y,
        uint16 altitude,
        uint16 battery,
        uint16 reputation,
        uint32 bandwidth
    );
    /// @notice A UAV rewrote its record.
    event UAVUpdated(address indexed uav, int32 x, int32 y, uint16 altitude, uint16 battery, uint32 bandwidth);
    /// @notice A UAV entered, changed or left (`to` 0) a zone.
    event UAVZoneUpdated(address indexed uav, uint32 indexed from, uint32 indexed to);
    /// @notice Proposals to and selections by a UAV are void; its session is now `session`.
    event UAVSubmissionReset(address indexed uav, uint32 session);
    /// @notice A member became a vehicle.
    event VehicleRegistered(
        address indexed vehicle, int32 x, int32 y, uint32 payment, uint16 reputation, uint32 zone
    );
    /// @notice A vehicle rewrote its record.
    event VehicleUpdated(address indexed vehicle, int32 x, int32 y, uint32 payment, uint32 zone);

    /// @notice The first UAV entered a zone: its first period begins.
    event ZoneOpened(uint32 indexed zone);
    /// @notice A vehicle proposed; `index` is its place in the UAV's list of this `session`.
    event VehSelectionSubmitted(
        address indexed vehicle,
        address indexed uav,
        uint32 indexed zone,
        uint32 round,
        uint32 session,
        uint16 index,
        uint32 demand,
        uint64 qov,
        uint64 score
    );
    /// @notice A vehicle changed zone: its open proposal or its selection is void.
    event VehSelectionWithdrawn(address indexed vehicle, address indexed uav, uint32 session, uint16 index);
    /// @notice A UAV's proposals with an index below `decided` are decided: `selected`, in the order taken, use
    /// `committed` of its bandwidth; all others are rejected.
    event UAVAllocated(
        address indexed uav,
        uint32 indexed zone,
        uint32 round,
        uint32 session,
        uint16 decided,
        uint32 committed,
        address[] selected
    );
    /// @notice Every proposal of a zone's `round` is decided.
    event ZoneAllocated(
        uint32 indexed zone, uint32 period, uint32 round, uint32 selectedUAVs, uint32 selectedVehicles
    );
    /// @notice The next period of a zone begins, with `round`: what belonged to the one before is void.
    event ZoneListsReset(uint32 indexed zone, uint32 period, uint32 round);

    /// @notice A model is in use.
    event ModelRegistered(bytes32 indexed modelId, address indexed owner, bytes cid, ModelCard card);
    /// @notice A model is out of use; zones that it was assigned to keep it.
    event ModelRetired(bytes32 indexed modelId);
    /// @notice A zone's team is to fly a model, for these numbers of selected UAVs and vehicles.
    event ModelAssigned(
        uint32 indexed zone, bytes32 indexed modelId, uint32 round, uint32 selectedUAVs, uint32 selectedVehicles
    );

    /// @notice The authority set a reputation.
    event ReputationSet(address indexed member, uint16 reputation);
    /// @notice A member was rated by one that it was matched with; `reputation` is the new one.
    event MemberRated(address indexed member, address indexed by, bool good, uint16 reputation);

    /// @notice Weights that do not sum to one, a maximum of 0, a value above its own maximum, or an extension without code.
    error InvalidParameters();
    /// @notice An address is one member, of one kind.
    error AlreadyRegistered(address member);
    /// @notice The address is no member.
    error UnknownMember(address member);
    /// @notice The address is no UAV.
    error UnknownUAV(address uav);
    /// @notice The address is no vehicle.
    error UnknownVehicle(address vehicle);
    /// @notice No UAV ever entered the zone.
    error UnknownZone(uint32 zone);
    /// @notice No model has this id, or it is retired already.
    error UnknownModel(bytes32 modelId);
    /// @notice A member writes its own record only.
    error NotOwnRecord(address record, address caller);
    /// @notice A value above its maximum, or a demand of 0.
    error OutOfRange(uint256 value, uint256 maximum);
    /// @notice The UAV is in this zone already.
    error SameZone(uint32 zone);
    /// @notice A vehicle proposes to UAVs of its own zone.
    error DifferentZone(uint32 vehicleZone, uint32 uavZone);
    /// @notice The UAV is beyond the range gate; both in 1e-16 m.
    error TooFar(uint256 distance, uint256 maximum);
    /// @notice The UAV's battery is empty.
    error UAVEmpty(address uav);
    /// @notice The proposal is for another round of the zone than the current one.
    error WrongRound(uint32 given, uint32 current);
    /// @notice Between the first and the last piece of an allocation.
    error ZoneAllocating(uint32 zone);
    /// @notice The vehicle has an open proposal in this round.
    error ProposalOpen(address vehicle);
    /// @notice The vehicle is served in this period.
    error AlreadySelected(address vehicle);
    /// @notice The UAV rejected the vehicle's latest proposal: not to it again at once.
    error AlreadyRejected(address vehicle, address uav);
    /// @notice The UAV has taken as many proposals as a period allows.
    error ProposalListFull(address uav);
    /// @notice A UAV may not declare less than it has promised in the period.
    error BandwidthCommitted(uint32 bandwidth, uint32 committed);
    /// @notice A piece of an allocation has room for one proposal at least.
    error NoWork();
    /// @notice No UAV of the zone serves anyone: there is no team to assign a model to.
    error NothingSelected(uint32 zone);
    /// @notice No model is in use.
    error NoModels();
    /// @notice The registry is full: one has to be retired first.
    error TooManyModels(uint256 maximum);
    /// @notice Not a binary CIDv1 with a sha2-256 multihash.
    error InvalidCID(bytes cid);
    /// @notice Ranges the wrong way round, no UAV, or an even side.
    error InvalidCard();
    /// @notice A side, channels or actions that the contract was not deployed for.
    error ModelDoesNotFit(uint16 observationSide, uint8 channels, uint8 actions);
    /// @notice The same CID and card were registered before.
    error ModelAlreadyRegistered(bytes32 modelId);
    /// @notice A value for each member.
    error LengthMismatch(uint256 members, uint256 values);
    /// @notice The contract was deployed without ratings.
    error RatingsOff();
    /// @notice The two were not matched in the UAV's last finished session, or have rated already.
    error NotMatched(address vehicle, address uav);
}
