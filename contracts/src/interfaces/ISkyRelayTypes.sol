// SPDX-License-Identifier: Apache-2.0
pragma solidity 0.8.26;

import {Place, Terms} from "../libraries/Records.sol";

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
        /// True: members need a registrar's voucher to register; false: anyone may.
        bool admission;
        /// How long a UAV takes proposals after it last wrote its record [s]; 0: for ever.
        uint32 staleAfter;
        /// How long after a round's first proposal anyone may have the zone allocated [s].
        uint32 allocationDeadline;
        /// How long a period lasts at the least [s]; 0: as the coordinator likes, and it alone ends one.
        uint32 minimumPeriod;
        /// How long a change of the administrator takes at the least [s].
        uint32 adminDelay;
        /// A member's reputation changes once in so many blocks at the most, and what it was stays known: what claims of a
        /// selection need (OptimisticSelection). 0: as often as anyone likes, and no claims.
        uint32 settling;
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

    /// @notice Table "Data Structures", VehicleSelection. Status None: the vehicle was selected and gave it up.
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
        /// True where a proposal of the round is not decided.
        bool waiting;
        /// True: no proposal is taken until the registrar lets the zone work again.
        bool suspended;
        /// The round's first proposal; where it has none, the end of the last round or period [s].
        uint32 since;
        /// When the period began [s].
        uint32 begun;
        /// Who alone coordinates the zone; 0: whoever has COORDINATOR_ROLE.
        address coordinator;
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

    /// @notice A vehicle's signed proposal: x 0:32, y 32:32, payment 64:32, demand 96:32 and the time of the vehicle's
    /// record that it replaces 128:32, signed (EIP-712) with UAV, zone and round; signature as of EIP-2098.
    struct SignedProposal {
        uint256 terms;
        bytes32 r;
        bytes32 vs;
    }

    /// @notice Signed proposals to one UAV.
    struct SignedBatch {
        address uav;
        SignedProposal[] proposals;
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
    /// @notice A vehicle proposed. `terms`: what the QoV was computed from, which is the vehicle's record from here on;
    /// `place`: QoV, score, and where in the UAV's list of a session it stands.
    event VehSelectionSubmitted(
        address indexed vehicle, address indexed uav, uint32 indexed zone, Terms terms, Place place
    );
    /// @notice A vehicle left its zone or was suspended. An open proposal's place goes to the last one of the list; a
    /// selection stays where it is, without demand, so that the UAV can rate who gave it up.
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
    /// @notice A piece of an allocation has decided the UAVs of the zone's list before `cursor`; another has to follow.
    event ZonePieceAllocated(uint32 indexed zone, uint32 round, uint16 cursor);
    /// @notice Every proposal of a zone's `round` is decided.
    event ZoneAllocated(
        uint32 indexed zone, uint32 period, uint32 round, uint32 selectedUAVs, uint32 selectedVehicles
    );
    /// @notice What claims have decided in a zone's period is void: one was wrong. Proposals are taken again.
    event ZoneUnsettled(uint32 indexed zone, uint32 period);
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

    /// @notice A registrar's voucher lets an address register as this kind of member: 1 UAV, 2 vehicle.
    event MemberAdmitted(address indexed member, uint8 kind, address indexed registrar);
    /// @notice A member is kept from taking part, or may again.
    event MemberSuspended(address indexed member, bool suspended);
    /// @notice A zone takes no proposals, or does again.
    event ZoneSuspended(uint32 indexed zone, bool suspended);
    /// @notice A zone has a coordinator of its own; 0: none but the holders of COORDINATOR_ROLE.
    event ZoneCoordinatorSet(uint32 indexed zone, address coordinator);

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
    /// @notice A member writes its own record only; a UAV that is stale or suspended may be reset by anyone.
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
    /// @notice The UAV has not written its record for too long.
    error UAVStale(address uav, uint256 timestamp);
    /// @notice The UAV's proposals were voided in this period: it takes none until the next.
    error UAVClosed(address uav);
    /// @notice The member is suspended.
    error Suspended(address member);
    /// @notice The zone is suspended.
    error SuspendedZone(uint32 zone);
    /// @notice What a vehicle has proposed stays until the proposal is decided against or its period is over.
    error TermsFrozen(address vehicle);
    /// @notice The proposal is for another round of the zone than the current one.
    error WrongRound(uint32 given, uint32 current);
    /// @notice Between the first and the last piece of an allocation.
    error ZoneAllocating(uint32 zone);
    /// @notice Claims decide the zone in this period.
    error ZoneClaimed(uint32 zone);
    /// @notice The zone has selections of this period that no claim has made.
    error ZoneDecided(uint32 zone);
    /// @notice The member's reputation has changed lately: not again before `settling` blocks have passed.
    error ReputationSettling(address member);
    /// @notice The vehicle has an open proposal in this round.
    error ProposalOpen(address vehicle);
    /// @notice The vehicle is served in this period.
    error AlreadySelected(address vehicle);
    /// @notice The UAV rejected the vehicle's latest proposal: not to it again at once.
    error AlreadyRejected(address vehicle, address uav);
    /// @notice The UAV has taken as many proposals as a period allows.
    error ProposalListFull(address uav);
    /// @notice A UAV that vehicles have proposed to in the period may not declare less than it did.
    error BandwidthCommitted(uint32 bandwidth, uint32 declared);
    /// @notice A period ends when every proposal of its zone is decided.
    error ProposalsUndecided(uint32 zone);
    /// @notice The period lasts until then [s] at the least.
    error PeriodNotDue(uint32 zone, uint256 due);
    /// @notice The zone has a coordinator of its own.
    error NotCoordinator(uint32 zone, address caller);
    /// @notice The registrar has not admitted the address as this kind of member.
    error NotAdmitted(address member);
    /// @notice The contract was deployed without admission.
    error AdmissionOpen();
    /// @notice The voucher is another's, no registrar's, too old or for no kind of member.
    error InvalidVoucher();
    /// @notice The administrator's delay is fixed at deployment.
    error AdminDelayFixed();
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
    /// @notice Ranges the wrong way round, no UAV, an even side, or a score above 0, which no return is.
    error InvalidCard();
    /// @notice A side, channels or actions that the contract was not deployed for.
    error ModelDoesNotFit(uint16 observationSide, uint8 channels, uint8 actions);
    /// @notice The same owner registered the same CID and card before.
    error ModelAlreadyRegistered(bytes32 modelId);
    /// @notice A value for each member.
    error LengthMismatch(uint256 members, uint256 values);
    /// @notice The contract was deployed without ratings.
    error RatingsOff();
    /// @notice The two were not matched in the UAV's last finished session, or have rated already.
    error NotMatched(address vehicle, address uav);
}
