// SPDX-License-Identifier: Apache-2.0
pragma solidity 0.8.26;

/// @title SkyRelay: selection of UAV relays for connected vehicles
/// @notice Members keep their own record; vehicles propose to UAVs of their zone; the coordinator runs Algorithm 2;
/// a trained policy is assigned to each zone by content address. Every state change emits an event, and the events
/// alone suffice to rebuild every selection.
/// @dev Units: positions and distances 0.1 m; altitude 1 m; bandwidth and demand 1 kbit/s; payment 1 cent per Mbit/s;
/// battery and reputation 0.01 (0 to 10,000); QoV 1e-15 (100 is 1e17); score 1e-17 of QoV per square root of kbit/s.
/// Zone 0 is no zone. A period of a zone starts with `resetListsForZone` and has one or more rounds; a round ends
/// when `allocateZone` has decided every proposal of the zone.
interface ISkyRelay {
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

    event Deployed(Parameters parameters);

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
    event UAVUpdated(address indexed uav, int32 x, int32 y, uint16 altitude, uint16 battery, uint32 bandwidth);
    /// @notice A UAV entered, changed or left (`to` 0) a zone.
    event UAVZoneUpdated(address indexed uav, uint32 indexed from, uint32 indexed to);
    /// @notice Proposals to and selections by a UAV are void; its session is now `session`.
    event UAVSubmissionReset(address indexed uav, uint32 session);
    event VehicleRegistered(
        address indexed vehicle, int32 x, int32 y, uint32 payment, uint16 reputation, uint32 zone
    );
    event VehicleUpdated(address indexed vehicle, int32 x, int32 y, uint32 payment, uint32 zone);

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
    event ZoneListsReset(uint32 indexed zone, uint32 period, uint32 round);

    event ModelRegistered(bytes32 indexed modelId, address indexed owner, bytes cid, ModelCard card);
    event ModelRetired(bytes32 indexed modelId);
    event ModelAssigned(
        uint32 indexed zone, bytes32 indexed modelId, uint32 round, uint32 selectedUAVs, uint32 selectedVehicles
    );

    event ReputationSet(address indexed member, uint16 reputation);
    event MemberRated(address indexed member, address indexed by, bool good, uint16 reputation);

    error InvalidParameters();
    error AlreadyRegistered(address member);
    error UnknownUAV(address uav);
    error UnknownVehicle(address vehicle);
    error UnknownZone(uint32 zone);
    error UnknownModel(bytes32 modelId);
    error NotOwnRecord(address record, address caller);
    error OutOfRange(uint256 value, uint256 maximum);
    error SameZone(uint32 zone);
    error DifferentZone(uint32 vehicleZone, uint32 uavZone);
    error TooFar(uint256 distance, uint256 maximum);
    error UAVEmpty(address uav);
    error WrongRound(uint32 given, uint32 current);
    error ZoneAllocating(uint32 zone);
    error ProposalOpen(address vehicle);
    error AlreadySelected(address vehicle);
    error AlreadyRejected(address vehicle, address uav);
    error ProposalListFull(address uav);
    error BandwidthCommitted(uint32 bandwidth, uint32 committed);
    error NoWork();
    error NothingSelected(uint32 zone);
    error NoModels();
    error TooManyModels(uint256 maximum);
    error InvalidCID(bytes cid);
    error InvalidCard();
    error ModelDoesNotFit(uint16 observationSide, uint8 channels, uint8 actions);
    error ModelAlreadyRegistered(bytes32 modelId);
    error LengthMismatch(uint256 members, uint256 values);
    error RatingsOff();
    error NotMatched(address vehicle, address uav);

    /// @notice Register the caller as a UAV with the initial reputation; `zone` 0 puts it into the pool.
    function registerUAV(int32 x, int32 y, uint16 altitude, uint16 battery, uint32 bandwidth, uint32 zone) external;

    /// @notice Register the caller as a vehicle with the initial reputation.
    function registerVehicle(int32 x, int32 y, uint32 payment, uint32 zone) external;

    /// @notice Rewrite the caller's vehicle record. A change of zone withdraws its proposal or selection.
    function updateVehicleInfo(int32 x, int32 y, uint32 payment, uint32 zone) external;

    /// @notice Rewrite the caller's UAV record. Battery 0 voids its proposals and selections; otherwise bandwidth may
    /// not fall below what is committed in the current period.
    function updateUAVInfo(int32 x, int32 y, uint16 altitude, uint16 battery, uint32 bandwidth) external;

    /// @notice Move the calling UAV to `zone`; 0 leaves. Its proposals and selections are void.
    function updateUAVZone(address uav, uint32 zone) external;

    /// @notice Propose to `uav`, asking for `demand`. QoV and score are computed here, from the stored records.
    /// @param round the zone's round that the proposal is for: one that comes late is refused.
    function submitVehSelection(address uav, uint32 demand, uint32 round) external;

    /// @notice Algorithm 2 over the UAVs of a zone, in pieces. The first piece closes the zone to proposals, the last
    /// one opens the next round.
    /// @param maxProposals stop before a UAV that would bring the piece above so many (a UAV without new proposals
    /// counts as one); the first UAV of a piece is always decided.
    /// @return done true when every proposal of the zone is decided.
    function allocateZone(uint32 zone, uint256 maxProposals) external returns (bool done);

    /// @notice Close the period: all proposals, selections and the model of the zone are void.
    function resetListsForZone(uint32 zone) external;

    /// @notice Void the proposals to and the selections by one UAV; by itself or the coordinator.
    function resetUAVSubmission(address uav) external;

    /// @notice Publish a model. Its id is the hash of its CID and card.
    /// @param cid binary CIDv1 with a sha2-256 multihash (36 bytes).
    function registerModel(bytes calldata cid, ModelCard calldata card) external returns (bytes32 modelId);

    /// @notice Take a model out of use, by its owner or an admin. Zones that it was assigned to keep it.
    function retireModel(bytes32 modelId) external;

    /// @notice Assign the zone the model that fits its numbers of selected UAVs and vehicles best: least UAVs outside
    /// the trained range, then least vehicles outside, then the highest score, then the first registered.
    function determineMDRLModel(uint32 zone) external returns (bytes32 modelId);

    /// @notice Set reputations by the consortium's authority.
    function setReputations(address[] calldata members, uint16[] calldata reputations) external;

    /// @notice Rate the UAV that selected the calling vehicle in its last finished session, once.
    function rateUAV(address uav, bool good) external;

    /// @notice Rate a vehicle that the calling UAV selected in its last finished session, once.
    /// @param index of the vehicle's proposal in that session.
    function rateVehicle(address vehicle, uint16 index, bool good) external;

    function getUAVInfo(address uav) external view returns (UAVInfo memory);

    function getVehicleInfo(address vehicle) external view returns (VehicleInfo memory);

    /// @notice UAVs of a zone, in list order.
    function getZoneUAV(uint32 zone) external view returns (address[] memory);

    /// @notice UAVs of a zone that selected at least one vehicle in the current period.
    function getSelectedUAVs(uint32 zone) external view returns (address[] memory);

    function getZoneInfo(uint32 zone) external view returns (ZoneInfo memory);

    /// @notice The current period's proposals to a UAV, by index.
    function getProposals(address uav) external view returns (VehicleSelection[] memory);

    /// @notice The vehicle's latest proposal in the current period.
    function getVehicleSelection(address vehicle)
        external
        view
        returns (ProposalStatus status, address uav, uint16 index);

    /// @notice Eq. 2 and QoV/sqrt(RB) as a proposal would get them now.
    function quality(address vehicle, address uav, uint32 demand) external view returns (uint64 qov, uint64 score);

    function uavCount() external view returns (uint256);

    function uavAt(uint256 index) external view returns (address);

    function modelCount() external view returns (uint256);

    function modelAt(uint256 index) external view returns (bytes32);

    function getModel(bytes32 modelId)
        external
        view
        returns (bytes memory cid, ModelCard memory card, address owner, bool retired);
}
