// SPDX-License-Identifier: Apache-2.0
pragma solidity 0.8.26;

/// Records of one storage slot each, as words: a struct's decoding and encoding took a third of the code.
/// Fields are named with their first bit and their width; the functions below are their only readers and writers.

/// @dev A UAV or a vehicle. Both: x 0:32, y 32:32, timestamp 128:32, kind 160:7, suspended 167:1, reputation 168:16.
/// UAV: altitude 64:16, battery 80:16, bandwidth 96:32, zone 184:32, place in the zone's list 216:16, index 232:24.
/// Vehicle: payment 64:32, zone 96:32, and its latest proposal: UAV's index 184:24, session 208:32, proposal 240:16.
/// One that was admitted and has not registered yet has a kind and nothing else.
type Member is uint256;

/// @dev A UAV's proposals and selections in one period of one zone: number 0:32, zone 32:32, period 64:32; length of
/// its list 96:16, of which the first `decided` 112:16 have been through an allocation; vehicles selected 128:16;
/// bandwidth committed to them 144:32; which of the two lists 224:1; it has served somebody 225:1; it was voided and
/// takes nothing more in its period 226:1. Of the last session before it that served somebody: number 192:32,
/// `decided` 176:16.
/// It is over when the zone's period is another, or when the UAV left, ran empty or was reset.
type Session is uint256;

/// @dev demand 0:32, score 32:64, vehicle 96:160. A demand of 0: the vehicle was selected and gave it up.
type Proposal is uint256;

/// @dev period 0:32, round 32:32, UAVs 64:16, cursor of an allocation 80:16, UAVs with a selection 96:16, selected
/// vehicles 112:32, allocating 144:1, has a model 145:1, has undecided proposals 146:1, suspended 147:1, decided by
/// claims in this period 148:1; time of the round's first proposal, before it of the last allocation or reset 152:32;
/// time at which the period began 184:32.
/// 0 is unknown.
type Zone is uint256;

/// @dev What a member was: reputation 0:16 before block 16:64, in which it last changed; suspended or no longer 80:64.
type Past is uint256;

/// @dev What a proposal's QoV was computed from, in an event: x 0:32, y 32:32, payment 64:32, demand 96:32, UAV's x
/// 128:32 and y 160:32, reputation 192:16.
type Terms is uint256;

/// @dev Where a proposal stands, in an event: QoV 0:64, score 64:64, session 128:32, index 160:16, round 176:32.
type Place is uint256;

using MemberLibrary for Member global;
using SessionLibrary for Session global;
using ProposalLibrary for Proposal global;
using ZoneLibrary for Zone global;
using PastLibrary for Past global;

library MemberLibrary {
    uint256 internal constant UAV = 1;
    uint256 internal constant VEHICLE = 2;
    /// Of one that may register as the kind beside it.
    uint256 internal constant ADMITTED = 4;
    uint256 private constant SUSPENDED = 1 << 167;

    function x(Member m) internal pure returns (int256) {
        return int32(uint32(Member.unwrap(m)));
    }

    function y(Member m) internal pure returns (int256) {
        return int32(uint32(Member.unwrap(m) >> 32));
    }

    function timestamp(Member m) internal pure returns (uint256) {
        return uint32(Member.unwrap(m) >> 128);
    }

    function kind(Member m) internal pure returns (uint256) {
        return Member.unwrap(m) >> 160 & 0x7f;
    }

    function suspended(Member m) internal pure returns (bool) {
        return Member.unwrap(m) & SUSPENDED != 0;
    }

    function withSuspension(Member m, bool suspended_) internal pure returns (Member) {
        return Member.wrap(suspended_ ? Member.unwrap(m) | SUSPENDED : Member.unwrap(m) & ~SUSPENDED);
    }

    function reputation(Member m) internal pure returns (uint256) {
        return uint16(Member.unwrap(m) >> 168);
    }

    function withReputation(Member m, uint256 value) internal pure returns (Member) {
        return Member.wrap(Member.unwrap(m) & ~(uint256(0xffff) << 168) | value << 168);
    }

    /// @dev The fields below bit 160, which the member itself rewrites.
    function withInfo(Member m, uint256 info) internal pure returns (Member) {
        return Member.wrap(Member.unwrap(m) >> 160 << 160 | info);
    }

    // UAV

    function uavInfo(int32 x_, int32 y_, uint256 altitude_, uint256 battery_, uint256 bandwidth_)
        internal
        view
        returns (uint256)
    {
        return uint32(x_) | uint256(uint32(y_)) << 32 | altitude_ << 64 | battery_ << 80 | bandwidth_ << 96
            | uint256(uint32(block.timestamp)) << 128;
    }

    function altitude(Member m) internal pure returns (uint256) {
        return uint16(Member.unwrap(m) >> 64);
    }

    function battery(Member m) internal pure returns (uint256) {
        return uint16(Member.unwrap(m) >> 80);
    }

    function bandwidth(Member m) internal pure returns (uint256) {
        return uint32(Member.unwrap(m) >> 96);
    }

    /// @dev Position and bandwidth alone.
    function offered(Member m) internal pure returns (Member) {
        return Member.wrap(Member.unwrap(m) & (type(uint64).max | uint256(type(uint32).max) << 96));
    }

    function uavZone(Member m) internal pure returns (uint256) {
        return uint32(Member.unwrap(m) >> 184);
    }

    function place(Member m) internal pure returns (uint256) {
        return uint16(Member.unwrap(m) >> 216);
    }

    function index(Member m) internal pure returns (uint256) {
        return Member.unwrap(m) >> 232;
    }

    function withPlace(Member m, uint256 value) internal pure returns (Member) {
        return Member.wrap(Member.unwrap(m) & ~(uint256(0xffff) << 216) | value << 216);
    }

    /// @dev A UAV in another zone, written now.
    function withZone(Member m, uint256 zone, uint256 place_) internal view returns (Member) {
        uint256 kept = Member.unwrap(m) & ~(uint256(0xffffffffffff) << 184 | uint256(0xffffffff) << 128);
        return Member.wrap(kept | zone << 184 | place_ << 216 | uint256(uint32(block.timestamp)) << 128);
    }

    // Vehicle

    /// @dev `before` is the record that this one replaces: its time is one second earlier at the least, so that a
    /// record's time is never that of another, and what was signed for one record does not count for the next.
    function vehicleInfo(int32 x_, int32 y_, uint256 payment_, uint256 zone, Member before)
        internal
        view
        returns (uint256)
    {
        uint256 time = before.timestamp() + 1;
        if (time < block.timestamp) time = block.timestamp;
        return uint32(x_) | uint256(uint32(y_)) << 32 | payment_ << 64 | zone << 96 | uint256(uint32(time)) << 128;
    }

    function payment(Member m) internal pure returns (uint256) {
        return uint32(Member.unwrap(m) >> 64);
    }

    function vehicleZone(Member m) internal pure returns (uint256) {
        return uint32(Member.unwrap(m) >> 96);
    }

    function proposedUAV(Member m) internal pure returns (uint256) {
        return uint24(Member.unwrap(m) >> 184);
    }

    /// @dev 0 where the vehicle has no proposal to speak of.
    function proposedSession(Member m) internal pure returns (uint256) {
        return uint32(Member.unwrap(m) >> 208);
    }

    function proposedIndex(Member m) internal pure returns (uint256) {
        return Member.unwrap(m) >> 240;
    }

    function withProposal(Member m, uint256 uav, uint256 session, uint256 proposal) internal pure returns (Member) {
        return Member.wrap(uint184(Member.unwrap(m)) | uav << 184 | session << 208 | proposal << 240);
    }
}

library SessionLibrary {
    uint256 private constant SERVED = 1 << 225;
    uint256 private constant CLOSED = 1 << 226;

    function number(Session s) internal pure returns (uint256) {
        return uint32(Session.unwrap(s));
    }

    /// @dev Zone and period in one word, to compare with `ZoneLibrary.key`.
    function key(Session s) internal pure returns (uint256) {
        return uint64(Session.unwrap(s) >> 32);
    }

    function count(Session s) internal pure returns (uint256) {
        return uint16(Session.unwrap(s) >> 96);
    }

    function decided(Session s) internal pure returns (uint256) {
        return uint16(Session.unwrap(s) >> 112);
    }

    function selected(Session s) internal pure returns (uint256) {
        return uint16(Session.unwrap(s) >> 128);
    }

    function committed(Session s) internal pure returns (uint256) {
        return uint32(Session.unwrap(s) >> 144);
    }

    /// @dev `decided` of the last session before that served somebody.
    function decidedBefore(Session s) internal pure returns (uint256) {
        return uint16(Session.unwrap(s) >> 176);
    }

    /// @dev The last session before that served somebody; 0 where there is none.
    function numberBefore(Session s) internal pure returns (uint256) {
        return uint32(Session.unwrap(s) >> 192);
    }

    /// @dev Which of the UAV's two lists is this session's; the other is that of `numberBefore`.
    function list(Session s) internal pure returns (uint256) {
        return Session.unwrap(s) >> 224 & 1;
    }

    function served(Session s) internal pure returns (bool) {
        return Session.unwrap(s) & SERVED != 0;
    }

    function closed(Session s) internal pure returns (bool) {
        return Session.unwrap(s) & CLOSED != 0;
    }

    /// @dev The session after this one, without zone and proposals. One that has none serves again. Only one that
    /// served somebody leaves its list to be rated from, so that none can be pushed out by proposals that led nowhere.
    function next(Session s) internal pure returns (Session) {
        uint256 word = Session.unwrap(s);
        if (s.count() == 0) return Session.wrap(uint32(word) | word >> 176 << 176 & ~(SERVED | CLOSED));
        uint256 number_ = uint32(s.number() + 1);
        if (!s.served()) return Session.wrap(number_ | word >> 176 << 176 & ~CLOSED);
        return Session.wrap(number_ | s.decided() << 176 | s.number() << 192 | (1 - s.list()) << 224);
    }

    /// @dev A session without proposals, begun in a zone's period.
    function begun(Session s, uint256 key_) internal pure returns (Session) {
        return Session.wrap(Session.unwrap(s) | key_ << 32);
    }

    /// @dev The next session, which takes nothing in the period that this one was voided in.
    function voided(Session s) internal pure returns (Session) {
        return Session.wrap(Session.unwrap(s.next().begun(s.key())) | CLOSED);
    }

    function withOneMore(Session s) internal pure returns (Session) {
        unchecked {
            return Session.wrap(Session.unwrap(s) + (1 << 96));
        }
    }

    function withOneFewer(Session s) internal pure returns (Session) {
        unchecked {
            return Session.wrap(Session.unwrap(s) - (1 << 96));
        }
    }

    /// @dev All proposals are decided.
    function withSelection(Session s, uint256 selected_, uint256 committed_) internal pure returns (Session) {
        uint256 kept = Session.unwrap(s) & ~(uint256(0xffffffffffffffff) << 112);
        if (selected_ != 0) kept |= SERVED;
        return Session.wrap(kept | s.count() << 112 | selected_ << 128 | committed_ << 144);
    }

    function withOneSelectedLess(Session s, uint256 demand) internal pure returns (Session) {
        unchecked {
            return Session.wrap(Session.unwrap(s) - (1 << 128) - (demand << 144));
        }
    }
}

library ProposalLibrary {
    function pack(address vehicle_, uint256 demand_, uint256 score_) internal pure returns (Proposal) {
        return Proposal.wrap(uint256(uint160(vehicle_)) << 96 | score_ << 32 | demand_);
    }

    function demand(Proposal p) internal pure returns (uint256) {
        return uint32(Proposal.unwrap(p));
    }

    function score(Proposal p) internal pure returns (uint256) {
        return uint64(Proposal.unwrap(p) >> 32);
    }

    function vehicle(Proposal p) internal pure returns (address) {
        return address(uint160(Proposal.unwrap(p) >> 96));
    }

    function givenUp(Proposal p) internal pure returns (Proposal) {
        return Proposal.wrap(Proposal.unwrap(p) >> 32 << 32);
    }
}

library ZoneLibrary {
    uint256 private constant ALLOCATING = 1 << 144;
    uint256 private constant MODEL = 1 << 145;
    uint256 private constant WAITING = 1 << 146;
    uint256 private constant SUSPENDED = 1 << 147;
    uint256 private constant CLAIMED = 1 << 148;

    /// @dev A zone in its first round of its first period.
    function opened() internal view returns (Zone) {
        return Zone.wrap(1 << 32 | 1 | uint256(uint32(block.timestamp)) << 184).withSince();
    }

    function period(Zone z) internal pure returns (uint256) {
        return uint32(Zone.unwrap(z));
    }

    /// @dev A zone's id and period in one word, to compare with `SessionLibrary.key`.
    function key(Zone z, uint256 zone) internal pure returns (uint256) {
        return zone | z.period() << 32;
    }

    function round(Zone z) internal pure returns (uint256) {
        return uint32(Zone.unwrap(z) >> 32);
    }

    /// @dev UAVs in the zone's list.
    function uavs(Zone z) internal pure returns (uint256) {
        return uint16(Zone.unwrap(z) >> 64);
    }

    function withOneMoreUAV(Zone z) internal pure returns (Zone) {
        unchecked {
            return Zone.wrap(Zone.unwrap(z) + (1 << 64));
        }
    }

    function withOneLessUAV(Zone z) internal pure returns (Zone) {
        unchecked {
            return Zone.wrap(Zone.unwrap(z) - (1 << 64));
        }
    }

    function cursor(Zone z) internal pure returns (uint256) {
        return uint16(Zone.unwrap(z) >> 80);
    }

    function withCursor(Zone z, uint256 cursor_) internal pure returns (Zone) {
        return Zone.wrap(Zone.unwrap(z) & ~(uint256(0xffff) << 80) | cursor_ << 80);
    }

    function selectedUAVs(Zone z) internal pure returns (uint256) {
        return uint16(Zone.unwrap(z) >> 96);
    }

    function selectedVehicles(Zone z) internal pure returns (uint256) {
        return uint32(Zone.unwrap(z) >> 112);
    }

    /// @dev One UAV's number of selected vehicles changes.
    function withSelection(Zone z, uint256 before, uint256 after_) internal pure returns (Zone) {
        unchecked {
            uint256 word = Zone.unwrap(z) + (after_ << 112) - (before << 112);
            if (before != 0) word -= 1 << 96;
            if (after_ != 0) word += 1 << 96;
            return Zone.wrap(word);
        }
    }

    function allocating(Zone z) internal pure returns (bool) {
        return Zone.unwrap(z) & ALLOCATING != 0;
    }

    function hasModel(Zone z) internal pure returns (bool) {
        return Zone.unwrap(z) & MODEL != 0;
    }

    function withModel(Zone z) internal pure returns (Zone) {
        return Zone.wrap(Zone.unwrap(z) | MODEL);
    }

    /// @dev A proposal of this round is not decided yet.
    function waiting(Zone z) internal pure returns (bool) {
        return Zone.unwrap(z) & WAITING != 0;
    }

    /// @dev The round has its first proposal now.
    function withWaiting(Zone z) internal view returns (Zone) {
        return Zone.wrap(Zone.unwrap(z) | WAITING).withSince();
    }

    function suspended(Zone z) internal pure returns (bool) {
        return Zone.unwrap(z) & SUSPENDED != 0;
    }

    function withSuspension(Zone z, bool suspended_) internal pure returns (Zone) {
        return Zone.wrap(suspended_ ? Zone.unwrap(z) | SUSPENDED : Zone.unwrap(z) & ~SUSPENDED);
    }

    /// @dev When the round had its first proposal; where it has none, when the last round or period ended [s].
    function since(Zone z) internal pure returns (uint256) {
        return uint32(Zone.unwrap(z) >> 152);
    }

    function withSince(Zone z) internal view returns (Zone) {
        return Zone.wrap(Zone.unwrap(z) & ~(uint256(0xffffffff) << 152) | uint256(uint32(block.timestamp)) << 152);
    }

    /// @dev When the period began [s].
    function begun(Zone z) internal pure returns (uint256) {
        return uint32(Zone.unwrap(z) >> 184);
    }

    /// @dev Claims decide the zone until the period ends or one is proved wrong.
    function claimed(Zone z) internal pure returns (bool) {
        return Zone.unwrap(z) & CLAIMED != 0;
    }

    function withClaim(Zone z, uint256 uavs_, uint256 vehicles_) internal pure returns (Zone) {
        uint256 kept = Zone.unwrap(z) & ~(uint256(0xffffffffffff) << 96);
        return Zone.wrap(kept | uavs_ << 96 | vehicles_ << 112 | CLAIMED);
    }

    /// @dev Nobody is selected, and proposals are taken again.
    function withoutClaim(Zone z) internal pure returns (Zone) {
        return Zone.wrap(Zone.unwrap(z) & ~(uint256(0xffffffffffff) << 96 | CLAIMED | MODEL));
    }

    /// @dev Between two pieces of an allocation.
    function paused(Zone z, uint256 cursor_) internal pure returns (Zone) {
        return Zone.wrap(Zone.unwrap(z.withCursor(cursor_)) | ALLOCATING);
    }

    /// @dev The next round; selections and model stay.
    function nextRound(Zone z) internal view returns (Zone) {
        return Zone.wrap((Zone.unwrap(z.withCursor(0)) & ~(ALLOCATING | WAITING)) + (1 << 32)).withSince();
    }

    /// @dev The next period: only the list of UAVs and a suspension stay.
    function nextPeriod(Zone z) internal view returns (Zone) {
        uint256 word = uint80(Zone.unwrap(z) + (1 << 32) + 1) | Zone.unwrap(z) & SUSPENDED;
        return Zone.wrap(word | uint256(uint32(block.timestamp)) << 184).withSince();
    }
}

library PastLibrary {
    function reputation(Past p) internal pure returns (uint256) {
        return uint16(Past.unwrap(p));
    }

    /// @dev The block of the last change of the reputation; 0 where there was none.
    function rated(Past p) internal pure returns (uint256) {
        return uint64(Past.unwrap(p) >> 16);
    }

    /// @dev The block of the last suspension or its end; 0 where there was none.
    function suspended(Past p) internal pure returns (uint256) {
        return uint64(Past.unwrap(p) >> 80);
    }

    function withReputation(Past p, uint256 before) internal view returns (Past) {
        return Past.wrap(Past.unwrap(p) >> 80 << 80 | block.number << 16 | before);
    }

    function withSuspension(Past p) internal view returns (Past) {
        return Past.wrap(uint80(Past.unwrap(p)) | block.number << 80);
    }
}

library TermsLibrary {
    function pack(Member v, Member u, uint256 demand) internal pure returns (Terms) {
        return Terms.wrap(
            uint96(Member.unwrap(v)) | demand << 96 | uint256(uint64(Member.unwrap(u))) << 128 | v.reputation() << 192
        );
    }
}

library PlaceLibrary {
    function pack(uint256 qov, uint256 score, uint256 session, uint256 index, uint256 round)
        internal
        pure
        returns (Place)
    {
        return Place.wrap(qov | score << 64 | session << 128 | index << 160 | round << 176);
    }
}
