// SPDX-License-Identifier: Apache-2.0
pragma solidity 0.8.26;

import {ERC20} from "@openzeppelin/contracts/token/ERC20/ERC20.sol";
import {ECDSA} from "@openzeppelin/contracts/utils/cryptography/ECDSA.sol";
import {MessageHashUtils} from "@openzeppelin/contracts/utils/cryptography/MessageHashUtils.sol";
import {Math} from "@openzeppelin/contracts/utils/math/Math.sol";
import {SkyRelayRules} from "./SkyRelayRules.sol";
import {IOptimisticSelection} from "./interfaces/IOptimisticSelection.sol";
import {ISkyRelayExtension} from "./interfaces/ISkyRelayExtension.sol";
import {ProposalHeap} from "./libraries/ProposalHeap.sol";
import {Member, MemberLibrary} from "./libraries/Records.sol";

/// @title Selections by claim; the interface IOptimisticSelection says what each function does
/// @notice A contract of its own beside SkyRelay, which it reads, and whose zones it settles by the role SETTLER_ROLE. It
/// calls nothing else, and holds nothing but bonds.
contract OptimisticSelection is SkyRelayRules, ERC20, IOptimisticSelection {
    // What a challenge has to show at the most, and replay: 98 kB, in a transaction of 128 kB, and 12M gas.
    uint256 private constant MAX_ROUNDS = 6;
    uint256 private constant MAX_UAVS = 64;
    uint256 private constant MAX_NEW = 128;
    /// @dev Proposals to one UAV in a period.
    uint256 private constant MAX_PROPOSALS = 255;
    uint256 private constant TURNS = 8;
    bytes32 private constant ACKNOWLEDGEMENT = keccak256("Acknowledgement(bytes32 proposal,uint256 deadline)");

    ISkyRelayExtension private immutable RELAY;
    uint256 private immutable BOND;
    /// @dev Blocks from the reputations to the first claim, from there to the last, and from there to the end, each at most.
    uint256 private immutable WINDOW;

    /// @dev The claims of a zone's period.
    struct Period {
        /// The hash of each round with those before it.
        bytes32[MAX_ROUNDS] rounds;
        address claimant;
        uint32 number;
        uint48 asOf;
        uint8 count;
        State state;
    }

    /// @dev They take turns: a period's claims may be questioned while those of later ones are made.
    mapping(uint256 zone => Period[TURNS] periods) private _periods;

    constructor(Parameters memory p, ISkyRelayExtension relay, uint256 bond, uint256 supply)
        SkyRelayRules(p)
        ERC20("SkyRelay bond", "BOND")
    {
        if (p.settling < 3 || bond == 0) revert InvalidParameters();
        RELAY = relay;
        BOND = bond;
        WINDOW = p.settling / 3;
        _mint(msg.sender, supply);
    }

    // Claims

    /// @inheritdoc IOptimisticSelection
    function claim(uint32 zone, uint32 round, uint48 asOf, Share[] calldata shares) external {
        (Member[] memory records, uint32 period) = _settle(zone, round, shares);
        Leaf[] memory leaves = new Leaf[](shares.length);
        for (uint256 i = 0; i < shares.length; ++i) {
            leaves[i] = Leaf(shares[i].uav, _hash(records[i].offered(), shares[i]));
        }
        Period storage p = _claimable(zone, period, asOf);
        bytes32 before = p.count == 0 ? bytes32(0) : p.rounds[p.count - 1];
        p.rounds[p.count++] = _linked(before, round, keccak256(abi.encode(leaves)));
        emit Claimed(zone, period, round, msg.sender);
    }

    /// @inheritdoc IOptimisticSelection
    function prove(uint32 zone, uint32 round, Share[] calldata shares) external {
        (Member[] memory records, uint32 period) = _settle(zone, round, shares);
        Period storage p = _begun(zone, period);
        (p.claimant, p.number, p.asOf, p.count, p.state) = (msg.sender, period, uint48(block.number), 0, State.Final);
        uint256 count = 0;
        for (uint256 i = 0; i < shares.length; ++i) {
            count += shares[i].proposals.length;
        }
        address[] memory vehicles = new address[](count);
        bytes32 domain = _domain(address(RELAY));
        count = 0;
        for (uint256 i = 0; i < shares.length; ++i) {
            count = _sign(vehicles, count, domain, shares[i].uav, zone, round, shares[i].proposals);
        }
        _requireDistinct(vehicles);
        Member[] memory members = RELAY.recordsAt(vehicles, block.number);
        count = 0;
        for (uint256 i = 0; i < shares.length; ++i) {
            Share calldata share = shares[i];
            uint256[] memory words = new uint256[](share.proposals.length);
            bool right = share.before == 0 && _weigh(words, 0, members, count, records[i], share.proposals);
            if (!right || _chosen(words, 0, 0, words.length, records[i].bandwidth()) != share.selected) {
                revert WrongShare(share.uav);
            }
            count += words.length;
        }
        emit Claimed(zone, period, round, msg.sender);
    }

    /// @inheritdoc IOptimisticSelection
    function finalise(uint32 zone, uint32 period) external {
        Period storage p = _periods[zone][period % TURNS];
        if (p.number != period || p.state != State.Open || block.number <= _until(p)) revert NotInState(p.state);
        _release(zone, p);
    }

    /// @inheritdoc IOptimisticSelection
    function claims(uint32 zone, uint32 period)
        external
        view
        returns (State state, address claimant, uint48 asOf, uint8 count, uint256 until)
    {
        Period storage p = _periods[zone][period % TURNS];
        if (p.number == period) (state, claimant, asOf, count, until) = (p.state, p.claimant, p.asOf, p.count, _until(p));
    }

    // Challenges

    /// @inheritdoc IOptimisticSelection
    function challenge(uint32 zone, uint32 period, Part calldata part) external {
        Period storage p = _shown(zone, period, part);
        if (_isRight(zone, p.asOf, part)) revert ClaimHolds();
        _void(zone, p);
    }

    /// @inheritdoc IOptimisticSelection
    function challengeTwice(uint32 zone, uint32 period, Part calldata first, uint256 i, Part calldata second, uint256 j)
        external
    {
        Period storage p = _shown(zone, period, first);
        _shown(zone, period, second);
        if (first.rounds.length != second.rounds.length) revert NotClaimed();
        (address vehicle, uint256 taken, bool served) = _proposer(zone, first, i);
        (address again, uint256 last,) = _proposer(zone, second, j);
        bool same = first.uav == second.uav;
        if (
            vehicle == address(0) || vehicle != again || last != second.rounds.length - 1 || (same && i >= j)
                || !(same || taken == last || served)
        ) revert ClaimHolds();
        _void(zone, p);
    }

    /// @inheritdoc IOptimisticSelection
    function challengeOmission(
        uint32 zone,
        uint32 period,
        Part calldata part,
        SignedProposal calldata proposal,
        uint256 deadline,
        bytes calldata acknowledgement
    ) external {
        Period storage p = _shown(zone, period, part);
        Round calldata round = part.rounds[part.rounds.length - 1];
        bytes32 domain = _domain(address(RELAY));
        bytes32 digest = _digest(domain, part.uav, zone, round.round, proposal.terms);
        address vehicle = _signer(digest, proposal);
        bytes32 s = proposal.vs & bytes32(uint256(type(int256).max));
        bytes32 named = keccak256(bytes.concat(digest, proposal.r, s, bytes1(uint8(27 + (uint256(proposal.vs) >> 255)))));
        bytes32 word = MessageHashUtils.toTypedDataHash(domain, keccak256(abi.encode(ACKNOWLEDGEMENT, named, deadline)));
        if (vehicle == address(0) || ECDSA.recover(word, acknowledgement) != p.claimant) revert ClaimHolds();
        SignedProposal[] calldata taken = round.share.proposals;
        for (uint256 i = 0; i < taken.length && _place(round, part.uav) != type(uint256).max; ++i) {
            if (_signer(_digest(domain, part.uav, zone, round.round, taken[i].terms), taken[i]) == vehicle) revert ClaimHolds();
        }
        _void(zone, p);
    }

    // Periods

    /// @dev End the zone's round on SkyRelay with these shares' numbers; the records of their UAVs.
    function _settle(uint32 zone, uint32 round, Share[] calldata shares)
        private
        returns (Member[] memory records, uint32 period)
    {
        if (shares.length > MAX_UAVS) revert OutOfRange(shares.length, MAX_UAVS);
        address[] memory uavs = new address[](shares.length);
        for (uint256 i = 0; i < shares.length; ++i) {
            uavs[i] = shares[i].uav;
            if (i != 0 && uavs[i] <= uavs[i - 1]) revert UnfitShare(uavs[i]);
        }
        records = RELAY.recordsAt(uavs, block.number);
        int256 moreUAVs = 0;
        int256 moreVehicles = 0;
        for (uint256 i = 0; i < shares.length; ++i) {
            Share calldata share = shares[i];
            Member u = records[i];
            // slither-disable-start incorrect-equality (of lengths; the time is in another term)
            if (
                u.kind() != MemberLibrary.UAV || u.uavZone() != zone || u.battery() == 0 || u.suspended() || _isStale(u)
                    || share.proposals.length == 0 || share.proposals.length > MAX_NEW || share.before > MAX_PROPOSALS
            ) revert UnfitShare(share.uav);
            // slither-disable-end incorrect-equality
            uint256 served = _count(share.selected);
            unchecked {
                if (served != 0) ++moreUAVs;
                if (share.before != 0) --moreUAVs;
                moreVehicles += int256(served) - int256(share.before);
            }
        }
        period = RELAY.settle(zone, round, msg.sender, moreUAVs, moreVehicles);
    }

    /// @dev The place of a period that has no claims yet; who had it before has its bond back.
    function _begun(uint32 zone, uint32 period) private returns (Period storage p) {
        p = _periods[zone][period % TURNS];
        // slither-disable-next-line incorrect-equality (of numbers that count up)
        if (p.number == period) revert NotYourPeriod(zone, period);
        if (p.state == State.Open) {
            if (block.number <= _until(p)) revert NotInState(p.state);
            _release(zone, p);
        }
    }

    /// @dev The period's claims, which the caller may add one to: the first one takes the bond.
    function _claimable(uint32 zone, uint32 period, uint48 asOf) private returns (Period storage p) {
        p = _periods[zone][period % TURNS];
        if (p.number != period) {
            p = _begun(zone, period);
            if (asOf >= block.number || block.number > asOf + WINDOW) revert OutOfTime(asOf);
            (p.claimant, p.number, p.asOf, p.count, p.state) = (msg.sender, period, asOf, 0, State.Open);
            _transfer(msg.sender, address(this), BOND);
        } else if (p.state != State.Open || p.claimant != msg.sender || p.asOf != asOf || p.count == MAX_ROUNDS) {
            revert NotYourPeriod(zone, period);
        } else if (block.number > asOf + 2 * WINDOW) {
            revert OutOfTime(asOf);
        }
    }

    function _until(Period storage p) private view returns (uint256) {
        return p.asOf + 3 * WINDOW;
    }

    function _release(uint32 zone, Period storage p) private {
        p.state = State.Final;
        _transfer(address(this), p.claimant, BOND);
        emit ClaimFinal(zone, p.number, p.claimant);
    }

    function _void(uint32 zone, Period storage p) private {
        p.state = State.Void;
        _transfer(address(this), msg.sender, BOND / 2);
        // Who questions its own claim, before somebody else does, must not get all of it back.
        _burn(address(this), BOND - BOND / 2);
        emit ClaimVoided(zone, p.number, p.claimant, msg.sender);
        RELAY.unsettle(zone, p.number);
    }

    /// @dev The period's claims, which can be questioned and begin with the rounds shown; each with the UAV's share in it.
    function _shown(uint32 zone, uint32 period, Part calldata part) private view returns (Period storage p) {
        p = _periods[zone][period % TURNS];
        if (p.number != period || p.state != State.Open || block.number > _until(p)) revert NotInState(p.state);
        bytes32 chain = 0;
        for (uint256 i = 0; i < part.rounds.length; ++i) {
            Round calldata round = part.rounds[i];
            chain = _linked(chain, round.round, keccak256(abi.encode(round.leaves)));
            uint256 place = _place(round, part.uav);
            if (place != type(uint256).max) {
                // slither-disable-next-line incorrect-equality (of hashes)
                bool shown = round.share.uav == part.uav && round.leaves[place].share == _hash(round.record, round.share);
                if (!shown) revert NotClaimed();
            }
        }
        uint256 count = part.rounds.length;
        if (count == 0 || count > p.count || chain != p.rounds[count - 1]) revert NotClaimed();
    }

    // Replays

    /// @dev Whether everything claimed of a UAV is what SkyRelay would have come to.
    function _isRight(uint32 zone, uint256 asOf, Part calldata part) private view returns (bool) {
        (address[] memory vehicles, bool few) = _proposers(zone, part);
        if (!few) return false;
        Member[] memory members = RELAY.recordsAt(vehicles, asOf);
        uint256[] memory words = new uint256[](vehicles.length);
        uint256 held = 0;
        uint256 count = 0;
        for (uint256 k = 0; k < part.rounds.length; ++k) {
            Round calldata round = part.rounds[k];
            if (_place(round, part.uav) == type(uint256).max) continue;
            SignedProposal[] calldata proposals = round.share.proposals;
            if (!_weigh(words, count, members, count, round.record, proposals)) return false;
            if (round.share.before != _count(held)) return false;
            held = _chosen(words, held, count, count + proposals.length, round.record.bandwidth());
            if (held != round.share.selected) return false;
            count += proposals.length;
        }
        return true;
    }

    /// @dev Who signed each of a UAV's proposals, 0 where nobody did; and whether there are no more than a period allows.
    function _proposers(uint32 zone, Part calldata part) private view returns (address[] memory vehicles, bool few) {
        uint256 count = 0;
        for (uint256 k = 0; k < part.rounds.length; ++k) {
            if (_place(part.rounds[k], part.uav) != type(uint256).max) count += part.rounds[k].share.proposals.length;
        }
        if (count > MAX_PROPOSALS) return (vehicles, false);
        vehicles = new address[](count);
        bytes32 domain = _domain(address(RELAY));
        count = 0;
        for (uint256 k = 0; k < part.rounds.length; ++k) {
            Round calldata round = part.rounds[k];
            if (_place(round, part.uav) == type(uint256).max) continue;
            count = _sign(vehicles, count, domain, part.uav, zone, round.round, round.share.proposals);
        }
        return (vehicles, true);
    }

    /// @dev Enter who signed some proposals from place `count` on; the place after them.
    function _sign(
        address[] memory vehicles,
        uint256 count,
        bytes32 domain,
        address uav,
        uint32 zone,
        uint32 round,
        SignedProposal[] calldata proposals
    ) private pure returns (uint256) {
        for (uint256 i = 0; i < proposals.length; ++i) {
            uint256 free = _freeMemory();
            vehicles[count++] = _signer(_digest(domain, uav, zone, round, proposals[i].terms), proposals[i]);
            _free(free);
        }
        return count;
    }

    // slither-disable-next-line assembly
    function _freeMemory() private pure returns (uint256 pointer) {
        assembly ("memory-safe") {
            pointer := mload(0x40)
        }
    }

    /// @dev Use the memory again that was taken since: it costs the more, the more of it there is.
    // slither-disable-next-line assembly
    function _free(uint256 pointer) private pure {
        assembly ("memory-safe") {
            mstore(0x40, pointer)
        }
    }

    /// @dev Enter some proposals as Algorithm 2 orders them, from place `first` on; false where one would have been refused.
    function _weigh(
        uint256[] memory words,
        uint256 first,
        Member[] memory members,
        uint256 member,
        Member u,
        SignedProposal[] calldata proposals
    ) private view returns (bool) {
        unchecked {
            for (uint256 i = 0; i < proposals.length; ++i) {
                uint256 word = _word(members[member + i], u, proposals[i].terms, first + i);
                // slither-disable-next-line incorrect-equality (0 is what was refused)
                if (word == 0) return false;
                words[first + i] = word;
            }
        }
        return true;
    }

    /// @dev Each vehicle proposes once. A table in memory, four times as large, each one's place in it by its address.
    function _requireDistinct(address[] memory vehicles) private pure {
        uint256 last = (4 << Math.log2(vehicles.length | 1)) - 1;
        address[] memory table = new address[](last + 1);
        unchecked {
            for (uint256 i = 0; i < vehicles.length; ++i) {
                address vehicle = vehicles[i];
                uint256 place = uint160(vehicle) & last;
                while (table[place] != address(0)) {
                    if (table[place] == vehicle) revert ProposalOpen(vehicle);
                    place = (place + 1) & last;
                }
                table[place] = vehicle;
            }
        }
    }

    /// @dev Who signed a UAV's proposal `i`, which of the rounds shown it is in, and whether it was served before the last.
    function _proposer(uint32 zone, Part calldata part, uint256 i)
        private
        view
        returns (address vehicle, uint256 taken, bool served)
    {
        uint256 count = 0;
        for (uint256 k = 0; k < part.rounds.length; ++k) {
            Round calldata round = part.rounds[k];
            if (_place(round, part.uav) == type(uint256).max) continue;
            SignedProposal[] calldata proposals = round.share.proposals;
            if (i >= count && i < count + proposals.length) {
                SignedProposal calldata proposal = proposals[i - count];
                bytes32 digest = _digest(_domain(address(RELAY)), part.uav, zone, round.round, proposal.terms);
                (vehicle, taken) = (_signer(digest, proposal), k);
            }
            count += proposals.length;
            if (k + 1 < part.rounds.length) served = i < MAX_PROPOSALS && round.share.selected >> i & 1 != 0;
        }
    }

    /// @dev A proposal as Algorithm 2 orders it; 0 where it would have been refused.
    function _word(Member v, Member u, uint256 terms, uint256 place) private view returns (uint256) {
        uint256 demand = uint32(terms >> 96);
        if (
            terms >> 128 != 0 || v.kind() != MemberLibrary.VEHICLE || v.suspended() || demand == 0 || demand > MAX_DEMAND
                || uint32(terms >> 64) > MAX_PAYMENT
        ) return 0;
        (, uint256 score, uint256 distance) = _quality(v.withInfo(uint96(terms)), u, demand);
        if (RANGE_GATE && distance > MAX_DISTANCE) return 0;
        return ProposalHeap.word(score, place, place, demand);
    }

    /// @dev Algorithm 2 over the proposals held and those from `first` on.
    function _chosen(uint256[] memory words, uint256 held, uint256 first, uint256 count, uint256 bandwidth)
        private
        pure
        returns (uint256)
    {
        uint256[] memory heap = new uint256[](_count(held) + count - first);
        uint256 size = 0;
        unchecked {
            for (uint256 i = 0; i < count; ++i) {
                if (i >= first || held >> i & 1 != 0) heap[size++] = words[i];
            }
        }
        uint256[] memory bits = new uint256[](1);
        // slither-disable-next-line unused-return (the bits say it all)
        ProposalHeap.take(heap, bits, bandwidth);
        return bits[0];
    }

    // Hashes and signatures

    function _linked(bytes32 before, uint32 round, bytes32 leaves) private pure returns (bytes32) {
        return keccak256(abi.encode(before, round, leaves));
    }

    /// @dev The proposals stand in the calldata one after the other: copied whole, they cost a third.
    // slither-disable-next-line assembly
    function _hash(Member record, Share calldata share) private pure returns (bytes32) {
        SignedProposal[] calldata proposals = share.proposals;
        bytes32 hash;
        assembly ("memory-safe") {
            let pointer := mload(0x40)
            let size := mul(proposals.length, 0x60)
            calldatacopy(pointer, proposals.offset, size)
            hash := keccak256(pointer, size)
        }
        return keccak256(abi.encode(record, share.selected, share.before, hash));
    }

    /// @dev The UAV's place in a round; the largest number where it has no share in it.
    function _place(Round calldata round, address uav) private pure returns (uint256) {
        for (uint256 i = 0; i < round.leaves.length; ++i) {
            if (round.leaves[i].uav == uav) return i;
        }
        return type(uint256).max;
    }

    /// @dev How many bits are set, of 255 at the most: in pairs, fours, eights, and all of these added up in the highest.
    function _count(uint256 bits) private pure returns (uint256) {
        unchecked {
            bits -= bits >> 1 & type(uint256).max / 3;
            bits = (bits & type(uint256).max / 5) + (bits >> 2 & type(uint256).max / 5);
            bits = bits + (bits >> 4) & type(uint256).max / 17;
            // slither-disable-next-line divide-before-multiply (by constants, without a rest)
            return bits * (type(uint256).max / 255) >> 248;
        }
    }

    function _digest(bytes32 domain, address uav, uint32 zone, uint32 round, uint256 terms) private pure returns (bytes32) {
        return MessageHashUtils.toTypedDataHash(domain, _proposalHash(uav, zone, round, terms));
    }

    function _signer(bytes32 digest, SignedProposal calldata proposal) private pure returns (address signer) {
        // slither-disable-next-line unused-return (why a signature is none does not matter)
        (signer,,) = ECDSA.tryRecover(digest, proposal.r, proposal.vs);
    }
}
